// A line of bytes on a descriptor, with blocking calls: a serial line of the kernel, or a connection to a server.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "data/setting_mistake.hpp"
#include "rtdata/io/serial.hpp"

namespace rtdata::detail {

/// Connects within the limit, to the first address that accepts; the lookup of a name has no limit. Returns a
/// descriptor that does not block.
Result<int> connect_to(const std::string& host, std::uint16_t port, Duration limit);

/// Checks `device`, `host`, `port` and `run`. `keys`: those that exist, for messages.
SettingMistake mistake_in_place(const SerialPortConfig& config, const char* keys);
/// Reports it.
void check_place(const SerialPortConfig& config, const char* keys, const ConfigItem& item, Problems& problems);

/// A program that answers through its terminal. Not a serial device: SerialPortConfig::run.
std::shared_ptr<SerialTransport> make_program_line(std::vector<std::string> run);

/// Thread: as SerialTransport.
class StreamLine final : public SerialTransport {
 public:
  struct Kind {
    std::string name;                        ///< in errors: "/dev/ttyUSB0", "192.168.1.20 port 502"
    std::function<Result<int>()> open = {};  ///< a descriptor that does not block
    void (*close)(int) noexcept = nullptr;
    enum class Sort { device, connection, program } sort = Sort::device;
  };
  explicit StreamLine(Kind kind) : kind_(std::move(kind)) {}

  Result<void> open() override;
  Result<void> write(std::span<const std::uint8_t> bytes, Duration timeout) override;
  Result<std::size_t> read(std::span<std::uint8_t> bytes, Duration timeout) override;
  /// The next call opens it again.
  void drop();

 private:
  /// An open line. Shared with a call that hangs in it.
  struct Line;
  Result<std::shared_ptr<Line>> opened();
  Error gone(const std::shared_ptr<Line>& line, int number);
  Result<bool> wait(const std::shared_ptr<Line>& line, short what, Duration left);

  const Kind kind_;
  std::mutex mutex_;  // not while it is opened
  bool is_opening_ = false;
  std::shared_ptr<Line> line_;
};

}  // namespace rtdata::detail
