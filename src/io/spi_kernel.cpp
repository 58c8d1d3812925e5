// The kernel's SPI controllers: spidev, a device for each chip select.
#include <fcntl.h>
#include <linux/spi/spidev.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <map>
#include <mutex>

#include "rtdata/io/spi.hpp"

namespace rtdata {
namespace {

/// An open chip select. Shared with a transfer that hangs in it.
struct ChipSelect {
  int fd = -1;
  ChipSelect() = default;
  ChipSelect(const ChipSelect&) = delete;
  ChipSelect& operator=(const ChipSelect&) = delete;
  ~ChipSelect() {
    if (fd >= 0) ::close(fd);
  }
};

class KernelSpi final : public SpiTransport {
 public:
  explicit KernelSpi(std::string device) : device_(std::move(device)) {}

  int transfer(const SpiPlace& place, std::span<const SpiSegment> segments) noexcept override {
    int status = 0;
    const std::shared_ptr<ChipSelect> chip = open(place.chip_select, status);
    if (chip == nullptr) return status;
    // All programs that open the device share its mode, so another one may have changed it.
    std::uint32_t mode = place.mode;
    if (::ioctl(chip->fd, SPI_IOC_WR_MODE32, &mode) < 0) return errno;
    std::array<spi_ioc_transfer, SpiDevice::most_segments> transfers{};
    for (std::size_t i = 0; i < segments.size(); ++i) {
      const SpiSegment& segment = segments[i];
      spi_ioc_transfer& one = transfers[i];
      one.tx_buf = reinterpret_cast<std::uintptr_t>(segment.write.data());
      one.rx_buf = reinterpret_cast<std::uintptr_t>(segment.read.data());
      one.len = static_cast<std::uint32_t>(std::max(segment.write.size(), segment.read.size()));
      one.speed_hz = place.clock;
      one.bits_per_word = static_cast<std::uint8_t>(place.bits_per_word);
      const auto delay = std::chrono::duration_cast<std::chrono::microseconds>(segment.delay_after).count();
      one.delay_usecs = static_cast<std::uint16_t>(std::clamp<std::int64_t>(delay, 0, 65535));
      one.cs_change = segment.release_after && i + 1 < segments.size() ? 1 : 0;
    }
    // SPI_IOC_MESSAGE(n) needs n to be a constant.
    constexpr std::size_t size = sizeof(spi_ioc_transfer);
    const unsigned long request = _IOC(_IOC_WRITE, SPI_IOC_MAGIC, 0, size * segments.size());
    int done = 0;
    do {
      done = ::ioctl(chip->fd, request, transfers.data());
    } while (done < 0 && errno == EINTR);
    if (done >= 0) return 0;
    status = errno;
    if (status == ENODEV || status == ESHUTDOWN) forget(place.chip_select, chip);  // unplugged
    return status;
  }

 private:
  std::shared_ptr<ChipSelect> open(unsigned number, int& status) noexcept try {
    const std::lock_guard lock(mutex_);
    std::shared_ptr<ChipSelect>& known = open_[number];
    if (known != nullptr) return known;
    auto chip = std::make_shared<ChipSelect>();
    chip->fd = ::open((device_ + "." + std::to_string(number)).c_str(), O_RDWR | O_CLOEXEC);
    if (chip->fd < 0) {
      status = errno;
      return nullptr;
    }
    return known = std::move(chip);
  } catch (...) {
    status = ENOMEM;
    return nullptr;
  }
  void forget(unsigned number, const std::shared_ptr<ChipSelect>& chip) noexcept {
    const std::lock_guard lock(mutex_);
    const auto found = open_.find(number);
    if (found != open_.end() && found->second == chip) open_.erase(found);
  }

  const std::string device_;
  std::mutex mutex_;  // only while one is opened and forgotten
  std::map<unsigned, std::shared_ptr<ChipSelect>> open_;
};

}  // namespace

std::shared_ptr<SpiTransport> make_kernel_spi(std::string device) {
  return std::make_shared<KernelSpi>(std::move(device));
}

}  // namespace rtdata
