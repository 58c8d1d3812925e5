/// GpioLine, GpioEdges: lines of the kernel's GPIO chips (/dev/gpiochip0): read, set, and their edges on a loop.
///
///     auto led = rtdata::GpioLine::output({.line = "GPIO17", .safe = false});
///     led.set(true).or_throw();
///     rtdata::GpioEdges button(loop, {.line = 27, .chip = "gpiochip0", .bias = rtdata::GpioBias::pull_up},
///                              [](const rtdata::GpioEdge& edge) { ... });
///
/// A line is named by its name ("GPIO17", as the board calls it), by its number on the chip (17), or by both
/// ("gpiochip0:17"). A bare number needs `chip`, or a machine that has a single chip; a name that several chips have
/// needs `chip` too. The errors list the chips or lines. A chip is named by its file, or by its label
/// ("pinctrl-bcm2711").
///
/// Levels are logical: 1 is active, which is high unless `active_low`. An edge that rises makes the line active.
///
/// - An edge has the kernel's time, taken in its interrupt. If that is not the monotonic clock (kernels before 5.7,
///   with libgpiod 1), the edge gets the time at which it was read.
/// - libgpiod 2: the kernel numbers the edges of a line and keeps up to 1024 unread ones; it drops the oldest, and the
///   library counts the dropped ones. The kernel does `debounce`.
/// - libgpiod 1: the kernel keeps 16 edges, drops the newest, and reports no loss: `lost_is_known()` is false. A full
///   buffer is counted as an overflow. The library does `debounce`: an edge counts when the line has kept its level for
///   that time.
/// - The calls go to the kernel and return in microseconds, except for a chip behind a slow bus (an expander on I2C),
///   where they wait.
///
/// A line has one user: the object holds it until it is closed. Closing sets an output to `safe`, if given, before it
/// releases the line. After that the chip decides the level of the line; most chips keep it.
///
/// Errors: not-found (no such chip or line), bad-argument (ambiguous; settings that the chip does not support),
/// not-permitted (group `gpio`), busy (the line is in use: the error names the user), disconnected (the chip is gone).
///
/// Owner: the holder. Thread: GpioLine: one at a time; GpioEdges: the loop's (rules: handle.hpp).
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/data/config_value.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata {

/// Which line: "GPIO17", 17, "gpiochip0:17". In configurations a text or a number.
struct GpioLineName {
  std::string text = {};
  GpioLineName() = default;
  GpioLineName(std::string text_) : text(std::move(text_)) {}
  GpioLineName(const char* text_) : text(text_) {}
  GpioLineName(int number) : text(std::to_string(number)) {}
  GpioLineName(unsigned number) : text(std::to_string(number)) {}
  bool operator==(const GpioLineName&) const = default;
};

template <>
struct ConfigValue<GpioLineName> {
  static constexpr TextOrNumber accepts{0, 4294967295, "^[\\s\\S]+$"};
  static bool read(const ConfigItem& item, GpioLineName& out, Problems& problems);
  static void write(const GpioLineName& value, ConfigItem& item) { item.set(value.text); }
};

enum class GpioBias : std::uint8_t {
  as_is,  ///< whatever it is
  none,
  pull_up,
  pull_down
};
constexpr auto describe(type_tag<GpioBias>) {
  return enumeration("bias", value("as is", GpioBias::as_is), value("none", GpioBias::none),
                     value("pull-up", GpioBias::pull_up), value("pull-down", GpioBias::pull_down));
}
enum class GpioEdgeKind : std::uint8_t { rising, falling, both };
constexpr auto describe(type_tag<GpioEdgeKind>) {
  return enumeration("edges", value("rising", GpioEdgeKind::rising), value("falling", GpioEdgeKind::falling),
                     value("both", GpioEdgeKind::both));
}
enum class GpioDrive : std::uint8_t { push_pull, open_drain, open_source };
constexpr auto describe(type_tag<GpioDrive>) {
  return enumeration("drive", value("push-pull", GpioDrive::push_pull), value("open-drain", GpioDrive::open_drain),
                     value("open-source", GpioDrive::open_source));
}

/// A line that is read.
struct GpioInput {
  GpioLineName line = {};
  std::string chip = {};  ///< "gpiochip0", "/dev/gpiochip0" or its label; empty: the chip that has the line
  GpioBias bias = GpioBias::as_is;
  bool active_low = false;
  GpioEdgeKind edges = GpioEdgeKind::both;  ///< which edges count; for GpioEdges only, like `debounce`
  Duration debounce{0};                     ///< shorter levels are ignored as bounces; 0: every edge counts
  std::string consumer = "rtdata";          ///< the user's name as the kernel shows it, up to 31 bytes

  friend constexpr auto parameters(type_tag<GpioInput>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter(
            "line", &GpioInput::line,
            "name of the line (\"GPIO17\"), its number on the chip (17), or both chip and number (\"gpiochip0:17\")",
            required),
        parameter("chip", &GpioInput::chip, "chip of the line, such as gpiochip0; empty: the chip that has the line"),
        parameter("bias", &GpioInput::bias, "pull-up or pull-down resistor in the chip"),
        parameter("active_low", &GpioInput::active_low, "the line is active when it is low"),
        parameter("edges", &GpioInput::edges, "which edges count; a rising edge makes the line active"),
        parameter("debounce", &GpioInput::debounce,
                  "a level that is shorter than this is ignored; 0: every edge counts",
                  range(Duration{0}, Duration{10s})));
  }
};

/// A line that is set.
struct GpioOutput {
  GpioLineName line = {};
  std::string chip = {};
  GpioDrive drive = GpioDrive::push_pull;
  bool active_low = false;
  bool initial = false;           ///< its level from the moment it is requested
  bool keep = false;              ///< keep the present level instead of `initial`
  std::optional<bool> safe = {};  ///< its level at the end; empty: unchanged
  std::string consumer = "rtdata";
};

// The backend of the lines: the kernel's chips, the fake for tests (fake_gpio.hpp), or your own.

struct GpioLineInfo {
  std::string name = {};      ///< empty: it has none
  std::string consumer = {};  ///< who has the line, if known
  bool is_used = false;
};
struct GpioChipInfo {
  std::string path = {};  ///< "/dev/gpiochip0"
  std::string label = {};
  std::vector<GpioLineInfo> lines = {};  ///< by their numbers
  int error_number = 0;                  ///< errno, if it cannot be opened
};

/// An edge as the backend gives it.
struct GpioRawEdge {
  bool is_rising = false;    ///< the line became active
  std::int64_t time = 0;     ///< ns of CLOCK_MONOTONIC
  std::uint32_t number = 0;  ///< counts the line's edges from 1; after the maximum comes 0
};

/// A requested line; the destructor releases it. Thread: one at a time.
class GpioRequest {
 public:
  virtual ~GpioRequest() = default;
  /// 0, 1, or a negative errno.
  virtual int value() noexcept = 0;
  /// 0 or an errno.
  virtual int set(bool value) noexcept = 0;
  /// Readable while edges wait; never blocks.
  virtual int descriptor() const noexcept = 0;
  /// Takes the edges that wait, as many as there is room for. Returns their number, or a negative errno.
  virtual int read(std::span<GpioRawEdge> edges) noexcept = 0;
  /// Returns true if the chip is still there; not every kernel wakes waiting readers when a chip disappears. Must not
  /// block.
  virtual bool is_there() noexcept = 0;
};

class GpioBackend {
 public:
  virtual ~GpioBackend() = default;
  /// How many unread edges of a line its buffer holds; 0: unknown.
  virtual std::size_t kept_edges() const noexcept = 0;
  /// Whether `GpioRawEdge::number` is set.
  virtual bool numbers_edges() const noexcept = 0;
  /// True if the backend does `debounce`; otherwise the library does it.
  virtual bool debounces() const noexcept = 0;
  virtual std::vector<GpioChipInfo> chips() = 0;
  /// Null, with an errno: EBUSY when the line is in use.
  virtual std::unique_ptr<GpioRequest> take_input(const std::string& path, unsigned number, const GpioInput& settings,
                                                  bool with_edges, int& error_number) = 0;
  virtual std::unique_ptr<GpioRequest> take_output(const std::string& path, unsigned number, const GpioOutput& settings,
                                                   int& error_number) = 0;
};

/// The kernel's chips, by libgpiod. In the library rtdata_gpio (CMake rtdata::gpio, pkg-config rtdata-gpio), which
/// exists if libgpiod was found.
std::shared_ptr<GpioBackend> make_kernel_gpio();

/// A line that is read or set by the caller. Reading and setting go to the kernel, on any thread, one at a time.
class GpioLine {
 public:
  /// SetupError: see above.
  static GpioLine input(GpioInput settings) { return input(std::move(settings), make_kernel_gpio()); }
  static GpioLine input(GpioInput settings, const std::shared_ptr<GpioBackend>& backend);
  static GpioLine output(GpioOutput settings) { return output(std::move(settings), make_kernel_gpio()); }
  static GpioLine output(GpioOutput settings, const std::shared_ptr<GpioBackend>& backend);

  GpioLine() noexcept = default;
  GpioLine(GpioLine&& other) noexcept;
  GpioLine& operator=(GpioLine&& other) noexcept;
  ~GpioLine() { close(); }

  Result<bool> read() const;
  /// Error (bad-argument) for an input.
  Result<void> set(bool value);
  /// Sets an output to its safe value and releases the line. Does nothing when it is closed.
  void close() noexcept;
  bool is_open() const noexcept { return request_ != nullptr; }
  /// True if it is open and its chip is still there. Checks the chip's file and does not use the line.
  bool is_there() const noexcept { return request_ != nullptr && request_->is_there(); }
  /// "gpiochip0:17 (GPIO17)"
  const std::string& place() const noexcept { return place_; }

 private:
  GpioLine(std::string place, std::unique_ptr<GpioRequest> request, std::optional<bool> safe, bool is_output);
  std::string place_;
  std::unique_ptr<GpioRequest> request_;
  std::optional<bool> safe_;
  bool is_output_ = false;
};

struct GpioEdge {
  bool level = false;        ///< of the line after it
  MonotonicTime time{};      ///< the kernel's
  std::uint64_t number = 0;  ///< from 1 since the line was requested; edges known to be lost have numbers too
};

struct GpioEdgeCounts {
  std::uint64_t edges = 0;      ///< that the callback was given
  std::uint64_t lost = 0;       ///< numbered by the kernel, and dropped before they were read
  std::uint64_t filtered = 0;   ///< bounces, where `debounce` is done here
  std::uint64_t overflows = 0;  ///< how often the kernel's buffer was full: without numbers, edges may be lost
};

/// Calls back on the loop for each edge of a line. When the chip goes away, it calls `on_error` and stops; make a new
/// object when the chip is back.
class GpioEdges : public Handle {
 public:
  GpioEdges() noexcept = default;
  /// SetupError: see above.
  GpioEdges(Loop& loop, GpioInput settings, Callback<void(const GpioEdge&)> callback)
      : GpioEdges(loop, std::move(settings), std::move(callback), make_kernel_gpio()) {}
  GpioEdges(Loop& loop, GpioInput settings, Callback<void(const GpioEdge&)> callback,
            const std::shared_ptr<GpioBackend>& backend);

  /// The level of the line, now.
  Result<bool> read() const;
  /// Calls back for waiting edges now, not in the next turn.
  void take_waiting();
  GpioEdgeCounts counts() const noexcept;
  /// Whether the edges have numbers: without them `lost` is not known, and 0.
  bool lost_is_known() const noexcept;
  /// The error that stopped it.
  std::optional<Error> failure() const;
  /// Called once at the end, and when edges are or may be lost. Default: the loop's handler.
  void on_error(Callback<void(const ErrorReport&)> handler);
};

namespace detail {

/// The same, without an exception. Null, with the error.
std::unique_ptr<GpioRequest> take_gpio_input(GpioBackend& backend, const GpioInput& settings, bool with_edges,
                                             std::string& place, Error& error);

}  // namespace detail

}  // namespace rtdata
