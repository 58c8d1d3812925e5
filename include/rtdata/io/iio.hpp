/// IioDevice, IioCapture: a converter or sensor that a driver of the kernel serves (Industrial I/O).
///
///     auto imu = rtdata::IioDevice::find("mpu6050").or_throw();            // name, label, number or path
///     for (const rtdata::IioChannel& c : imu.channels()) std::cout << c.name << " in " << c.unit << '\n';
///     double z = imu.read(*imu.channel("accel_z")).or_throw();             // m/s2; asks the chip: may block
///
///     auto capture = rtdata::IioCapture::open(imu, {.channels = {"accel_x", "anglvel_z"}}).or_throw();
///     rtdata::FdWatch watch(loop, capture.fd(), rtdata::FdWatch::readable, [&](const rtdata::FdEvent&) {
///       while (const std::size_t bytes = capture.read(scans).or_throw())
///         for (std::size_t at = 0; at < bytes; at += capture.layout().size())
///           capture.layout().decode(&scans[at], values);
///     });
///
/// Everything is in SI units. Some of the kernel's units are not (voltage mV, temperature m°C, pressure kPa, magnetic
/// field Gs, ...; Documentation/ABI/testing/sysfs-bus-iio); `conversion` and `decode` include the factor.
///
/// A channel's name is that of its files without "in_" and "_raw" or "_input": "voltage0", "voltage0-voltage1",
/// "accel_x", "temp", "humidityrelative". The quantity and unit follow from the name, without the device.
///
/// Values; an IioCapture is its holder's. Thread: any, one at a time. Calls that touch files below /sys block
/// for as long as the driver needs to ask its chip: they belong on a lane. `IioCapture::read` never blocks.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata {

/// How one channel lies in a scan: what a file in_*_type says.
struct IioStorage {
  bool is_big_endian = false;
  bool is_signed = false;
  unsigned bits = 0;          ///< significant bits
  unsigned storage_bits = 0;  ///< 8, 16, 32 or 64: of one element
  unsigned repeat = 1;        ///< elements: 4 of a quaternion
  unsigned shift = 0;         ///< to the right, before the bits are taken

  std::size_t size() const noexcept { return std::size_t{storage_bits / 8} * repeat; }
  bool operator==(const IioStorage&) const = default;
};
/// "le:s12/16>>4", "be:u24/32X3>>8". Errors: bad-data.
Result<IioStorage> parse_iio_storage(std::string_view text);

/// What channels of one type measure.
struct IioQuantity {
  std::string_view type;     ///< "voltage", "accel"
  std::string_view unit;     ///< UCUM, SI where there is one; empty: none
  double factor = 1;         ///< from the kernel's unit to this one
  std::string_view kernels;  ///< the kernel's unit, for people
};
/// The quantity of a channel: for "accel_x" the one of "accel". Null: the kernel has no such type, or the rest of the
/// name is not an index or modifier.
const IioQuantity* iio_quantity(std::string_view channel) noexcept;
/// All quantities, sorted.
std::span<const IioQuantity> iio_quantities() noexcept;
/// Values of a channel: 4 of "rot_quaternion", else 1.
std::size_t iio_values(std::string_view channel) noexcept;

/// One input of a device.
struct IioChannel {
  std::string name;
  std::string unit;                        ///< UCUM
  std::string label = {};                  ///< the driver's or device tree's name for it
  bool is_processed = false;               ///< its file has the converted value ("_input"), not a code
  bool is_readable = false;                ///< it has a file; some channels are in the buffer only
  int index = -1;                          ///< in scans; -1: it is in none
  std::optional<IioStorage> storage = {};  ///< in scans
};

/// value = (code + offset) * scale, in `unit`.
struct IioConversion {
  double offset = 0;
  double scale = 1;
};

class IioDevice {
 public:
  /// `which`: its number ("0"), "iio:device0", a path below /sys or /dev, its label or its name. `root`: put before
  /// /sys and /dev. Errors: not-found (lists what there is), bad-argument (several of this name: lists them).
  static Result<IioDevice> find(const std::string& which, const std::string& root = {});
  /// Sorted by number.
  static std::vector<IioDevice> all(const std::string& root = {});

  unsigned number() const noexcept { return number_; }
  const std::string& name() const noexcept { return name_; }
  const std::string& label() const noexcept { return label_; }
  /// "/sys/bus/iio/devices/iio:device0"
  const std::string& folder() const noexcept { return folder_; }
  /// "/dev/iio:device0"
  const std::string& node() const noexcept { return node_; }
  /// "bmp280 (iio:device1)"
  std::string text() const;
  /// As they were when it was found. Sorted by index, then by name.
  const std::vector<IioChannel>& channels() const noexcept { return channels_; }
  /// Null: it has none of this name.
  const IioChannel* channel(std::string_view name) const noexcept;
  /// The same with an error that lists what there is.
  Result<IioChannel> channel_or_error(std::string_view name) const;
  bool has_buffer() const;

  /// A file of its folder, without the end of the line. Errors: not-found, busy, io-failed, disconnected.
  Result<std::string> attribute(const std::string& file) const;
  Result<double> number_of(const std::string& file) const;
  Result<void> set_attribute(const std::string& file, std::string_view text) const;
  bool has_attribute(const std::string& file) const;
  /// The path of the file of a channel's value.
  std::string file_of(const IioChannel& channel) const;

  /// The conversion to SI units, of codes or, if the channel's file has the converted value, of that value.
  Result<IioConversion> conversion(const IioChannel& channel) const;
  /// The same for scans, which always hold codes.
  Result<IioConversion> scan_conversion(const IioChannel& channel) const;
  /// One value, in the channel's unit. Errors: as `attribute`, and not-a-number. Blocks while the chip is asked.
  Result<double> read(const IioChannel& channel) const;

  /// The program that has its buffer, if visible: "process 1234 (iio_readdev)"; empty: unknown. Reads all of /proc.
  std::string holder() const;

 private:
  IioDevice() = default;
  void list_channels();
  Result<IioConversion> conversion(const IioChannel& channel, bool is_finished) const;
  std::optional<std::string> first_attribute(const IioChannel& channel, const char* what) const;

  unsigned number_ = 0;
  std::string root_, name_, label_, folder_, node_;
  std::vector<IioChannel> channels_;
};

/// Where the values of a scan lie. Each is aligned to its own size, and the scan to that of its largest.
class IioLayout {
 public:
  struct Channel {
    int index = 0;  ///< in the scan
    IioStorage storage = {};
    IioConversion conversion = {};
    std::size_t position = 0;   ///< index of its first value in the output of `decode`
    bool is_timestamp = false;  ///< the two above are unused then
  };
  /// The layout of a scan of these channels, in any order. Errors: bad-data (an index twice, a size that is no power of
  /// two, for which kernels differ; a time that is not one number of 64 bits).
  static Result<IioLayout> make(std::vector<Channel> channels);

  IioLayout() = default;
  /// Bytes of a scan.
  std::size_t size() const noexcept { return size_; }
  /// Values that `decode` writes.
  std::size_t values() const noexcept { return scales_.size(); }
  bool has_timestamp() const noexcept { return timestamp_.has_value(); }
  /// `scan`: `size()` bytes, aligned to nothing. `to`: room for `values()`.
  void decode(const std::byte* scan, double* to) const noexcept;
  /// ns of the device's clock; only when it has one.
  std::int64_t timestamp(const std::byte* scan) const noexcept {
    std::uint64_t word = 0;
    std::memcpy(&word, scan + timestamp_->at, sizeof word);
    if (!timestamp_->is_plain) word = __builtin_bswap64(word);
    return static_cast<std::int64_t>(word);
  }

 private:
  /// Consecutive values of one kind, in the scan and in the output of `decode`.
  struct Run {
    std::size_t at = 0;
    IioStorage storage;  ///< of each
    std::size_t position = 0;
    std::size_t count = 0;
    bool is_plain = false;  ///< signed, all bits count, in this machine's order: what most devices have
  };
  template <class Word>
  void decode_run(const Run& run, const std::byte* from, double* to) const noexcept;

  std::vector<Run> runs_;
  std::vector<double> offsets_, scales_;  // by position
  std::optional<Run> timestamp_;
  std::size_t size_ = 0;
};

struct IioCaptureConfig {
  std::vector<std::string> channels = {};  ///< in the order in which `decode` writes them
  std::string trigger = {};                ///< its name; empty: the device's own, or the present one
  Rate rate = {};                          ///< set in the trigger or the device; none: unchanged
  std::size_t length = 512;                ///< scans that the kernel's buffer holds
  std::size_t watermark = 1;               ///< scans that have to be there before the descriptor is readable
};

/// A device with its buffer enabled. Only one program can have it. The destructor disables and releases it.
class IioCapture {
 public:
  /// Blocks while the driver talks to its chip. Errors: busy (another program has it), not-found (no buffer, no such
  /// channel or trigger), not-permitted, out-of-range (the rate), bad-argument, io-failed.
  static Result<IioCapture> open(const IioDevice& device, const IioCaptureConfig& config);
  IioCapture(IioCapture&& other) noexcept;
  IioCapture& operator=(IioCapture&& other) noexcept;
  ~IioCapture();

  int fd() const noexcept { return fd_; }
  const IioLayout& layout() const noexcept { return layout_; }
  /// Bytes of whole scans; 0: there are none now. Errors: disconnected (the device is gone), io-failed.
  Result<std::size_t> read(std::span<std::byte> to);
  /// Scans a second that trigger or device are set to; 0: not known.
  double frequency() const noexcept { return frequency_; }
  /// The clock of the timestamps: "monotonic", or another, "realtime" with kernels before 4.8.
  const std::string& clock() const noexcept { return clock_; }
  /// Unusual conditions: the buffer was enabled although no program had it.
  const std::vector<std::string>& notes() const noexcept { return notes_; }
  /// Blocks as opening does.
  void close() noexcept;
  /// Leaves the buffer enabled, because the driver hangs. Does not block; the next program that opens the device takes
  /// the buffer over.
  void abandon() noexcept;

 private:
  IioCapture() = default;
  Result<void> set_up(const IioCaptureConfig& config);
  Result<void> set_trigger(const std::string& wanted);
  Result<void> set_rate(Rate rate);
  Result<void> set_channels(const IioCaptureConfig& config);
  Result<void> enable(const IioCaptureConfig& config);

  std::optional<IioDevice> device_;
  int fd_ = -1;
  bool is_on_ = false;
  IioLayout layout_;
  double frequency_ = 0;
  std::string trigger_folder_, trigger_;
  std::string clock_ = "realtime";
  std::vector<std::string> notes_;
};

}  // namespace rtdata
