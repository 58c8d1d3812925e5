/// InertialChip: accelerometers and gyroscopes on I2C or SPI that measure by themselves and keep their samples in a
/// FIFO. What differs between them is data, in an `InertialModel`: registers, codes, the shape of the FIFO, scales,
/// self-test.
///
/// The types `imu` and `accelerometer` (imu.hpp, accelerometer.hpp) use it and hold the tables of models:
///
///     class Tilt {                                       // a driver
///       rtdata::InertialChip chip_{model, models, settings};
///       rtdata::Result<void> read(rtdata::RegisterDevice& chip, rtdata::Samples<Value>& out) {
///         return chip_.read(chip, out, [](const rtdata::InertialSample& sample) {
///           return Value{sample.acceleration[0]};
///         });
///       }
///     };
///
/// Times: the chips give no timestamps. The newest sample of a read is at most one period old; the driver spreads the
/// others evenly since the last sample of the read before. It learns the chip's real rate, so each time is right within
/// one period.
///
/// Losses: samples are lost when the FIFO overflows, the chip loses its settings (they are set again), or a transfer
/// fails in the middle. The driver computes the number of lost samples from the time and the learned rate, within one
/// sample each time; exactly if a sample carries a counter (LSM6DSO). The same holds after the chip could not be read
/// and was opened again: all samples of that time count as lost, also if the chip had no power.
///
/// Used on the bus's lane, as drivers are.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <numbers>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/data/config_item.hpp"
#include "rtdata/detail/chips/inertial_model.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/io/registers.hpp"
#include "rtdata/io/spi.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

/// What is known about the samples of a chip that can no longer be read.
struct InertialMemory {
  MonotonicTime last{};  ///< of the last one that was read, lost, or waited for
  Duration period{0};    ///< 0: nothing was read yet
  std::uint64_t periods_until(MonotonicTime now) const noexcept {
    return period > Duration{0} && now > last ? static_cast<std::uint64_t>((now - last) / period) : 0;
  }
};

struct InertialSample {
  std::array<double, 3> acceleration{}, angular_velocity{};  ///< m/s2, rad/s
  std::optional<double> temperature{};                       ///< degrees Celsius
};

class InertialChip {
 public:
  /// What is wrong with a setting, and its key in the configuration.
  struct Mistake {
    std::string_view key;
    std::string why;
  };
  static std::vector<Mistake> mistakes_in(const InertialModel& model, const InertialSettings& settings) {
    std::vector<Mistake> mistakes;
    const auto check = [&](std::string_view key, std::span<const InertialChoice> choices,
                           std::optional<double> wanted) {
      if (!wanted || find(choices, *wanted) != nullptr) return;
      std::string list;
      for (const InertialChoice& one : choices) list += (list.empty() ? "" : ", ") + text_of(one.number);
      mistakes.push_back({key, choices.empty() ? "the " + std::string(model.chip.name) + " has no such setting"
                                               : text_of(*wanted) + " is not one of " + list + ", which the " +
                                                     std::string(model.chip.name) + " has"});
    };
    check("sample_rate", model.rates, settings.rate);
    check("acceleration_range", model.accelerations, settings.acceleration);
    check("angular_range", model.angles, settings.angle);
    check("bandwidth", model.filters, settings.filter);
    if (settings.self_test && model.self_test.acceleration_on == 0)
      mistakes.push_back({"self_test", "no limits are known for the self-test of the " + std::string(model.chip.name)});
    return mistakes;
  }
  static void check(const InertialModel& model, const InertialSettings& settings, const ConfigItem& item,
                    Problems& problems) {
    for (Mistake& mistake : mistakes_in(model, settings)) {
      const ConfigItem* at = item.find(mistake.key);
      problems.add((at != nullptr ? *at : item).problem("bad-value", std::move(mistake.why)));
    }
  }

  /// For how long its opening waits for the chip: `Driver::bus_time`.
  static Duration bus_time(const InertialModel& model, const InertialSettings& settings) {
    Duration setting_up{0};
    for (const InertialWrite& one : model.setting_up) setting_up += one.pause;
    if (!settings.self_test) return setting_up;
    return 2 * setting_up + 2 * settling + 2 * averaged * pause_between(period_of(tested_rate(model)));
  }

  /// `all`: all models of this kind, to recognise a wrong one by its identity. SetupError (bad-argument): a setting
  /// that the model does not have.
  InertialChip(const InertialModel& model, std::span<const InertialModel> all, const InertialSettings& settings)
      : model_(model), all_(all), is_tested_(settings.self_test), identity_(settings.identity) {
    for (Mistake& mistake : mistakes_in(model, settings))
      throw SetupError(
          {Errc::bad_argument, "cannot use this setting", std::string(mistake.key), std::move(mistake.why), ""});
    // By default the widest range, and the first rate from 100 Hz on.
    rate_ = settings.rate ? find(model.rates, *settings.rate) : &tested_rate(model);
    acceleration_ = chosen(model.accelerations, settings.acceleration);
    angle_ = chosen(model.angles, settings.angle);
    const InertialChoice* filter = settings.filter ? find(model.filters, *settings.filter) : nullptr;
    filter_code_ = filter != nullptr ? filter->code : 3;  // 42 Hz for models with a filter
    nominal_period_ = period_ = period_of(*rate_);
    bytes_.resize(model.fifo.capacity);
    found_.reserve(model.fifo.capacity / model.sample_bytes + 1);
    // Two words of 7 bytes a sample, plus half a sample from the read before.
    if (model.fifo.is_tagged) joined_.resize(model.fifo.capacity / 14 * 12 + 12);
  }

  /// Samples a second, and how many samples the FIFO holds.
  double sample_rate() const noexcept { return rate_->number; }
  std::size_t fifo_samples() const noexcept {
    return model_.fifo.capacity / (model_.fifo.is_tagged ? std::size_t{14} : model_.sample_bytes);
  }

  /// Checks the identity, runs the self-test, writes the settings; then the chip measures.
  Result<void> open(RegisterDevice& chip) {
    is_on_spi_ = chip.is_on_spi();
    if (auto first = choose_first_bank(chip); !first) return first;
    if (auto same = check_chip(chip); !same) return same;
    if (is_tested_) {
      if (auto passed = test(chip); !passed) return passed;
    }
    auto done = set_up(chip);
    const MonotonicTime now = Samples<int>::now();
    begin_at(now);
    if (before_.period > Duration{0}) {  // it has gone on measuring, or would have
      period_ = before_.period;
      unread_ = before_.periods_until(now);
      begin_at(before_.last + static_cast<std::int64_t>(unread_) * period_);
    }
    is_new_ = before_.period == Duration{0};
    is_open_ = static_cast<bool>(done);
    return done;
  }

  /// For the driver object that replaces this one: see driver.hpp.
  InertialMemory memory() const noexcept { return is_open_ ? InertialMemory{last_, period_} : before_; }
  /// Call before `open`: the first read then reports the samples lost since.
  void remember(const InertialMemory& memory) noexcept { before_ = memory; }

  /// Empties the FIFO; `make` makes the payload of a sample.
  template <class Value, class Make>
  Result<void> read(RegisterDevice& chip, Samples<Value>& out, const Make& make) {
    const InertialFifo& fifo = model_.fifo;
    out.lost_in_fault(std::exchange(unread_, 0));
    // A chip that has lost its settings would otherwise look like one without new samples.
    const Result<std::uint8_t> mode = chip.read_register(fifo.on.number);
    if (!mode) return mode.error();
    // These bits are not compared: an MPU-9250 clears them by itself.
    if (((*mode ^ value_of(fifo.on)) & ~fifo.on.on_spi) != 0) {
      if (auto same = check_chip(chip); !same) return same;  // it may be another one, put in its place between reads
      out.unreadable(chip.error(Errc::bad_data, what, "it has lost its settings", "check its supply"));
      auto done = set_up(chip);
      if (done) give_up_samples(Samples<Value>::now(), out);
      return done;
    }
    bool has_run_over = false;
    if (fifo.over_register != 0 && fifo.keeps_whole_samples) {  // before the samples, whose reading clears it
      const Result<std::uint8_t> over = chip.read_register(fifo.over_register);
      if (!over) return over.error();
      has_run_over = (*over & fifo.over_bit) != 0;
    }
    MonotonicTime asked{}, now{};
    std::uint32_t status = 0;
    // After a delayed read, the time of the sample count is uncertain: read it again, at most twice.
    for (int i = 0; i < 3 && (i == 0 || now - asked > 2 * period_); ++i) {
      asked = Samples<Value>::now();
      const Result<std::uint32_t> found = read_status(chip);
      if (!found) return found.error();
      now = Samples<Value>::now();
      status = *found | (status & fifo.over_mask);
    }
    const std::size_t filled = (status & fifo.count_mask) * fifo.count_bytes;
    if (filled > fifo.capacity) {
      return chip.error(Errc::bad_data, what,
                        "its FIFO has " + std::to_string(filled) + " bytes, more than it can hold", "check its wires");
    }
    has_run_over = has_run_over || (status & fifo.over_mask) != 0 || filled + model_.sample_bytes > fifo.capacity;
    if (!fifo.keeps_whole_samples && (has_run_over || is_torn_ || (status & fifo.torn_mask) != 0))
      return restart(chip, out);
    if (filled == 0 && !has_run_over) return {};

    std::size_t read = 0;
    Result<void> result = read_fifo(chip, filled, read);
    if (!fifo.keeps_whole_samples) {
      is_torn_ = true;  // if this fails, it is unknown how many bytes were read and where the next sample begins
      if (!result) {
        (void)restart(chip, out);
        return result;
      }
      // Check after the read: an overflow during the read drops bytes of the samples being read.
      const Result<bool> over = has_run_over_meanwhile(chip);
      if (!over) return over.error();
      if (*over) return restart(chip, out);
      is_torn_ = false;
    }
    std::optional<double> temperature;
    if (result && model_.temperature_register != 0) {
      std::array<std::uint8_t, 2> bytes{};
      result = chip.read_registers(model_.temperature_register, bytes);
      if (result) temperature = degrees(bytes, 0);
    }
    const bool has_gap = has_run_over || is_uncertain_ || may_have_gap(filled, asked);
    const bool has_samples = take(read, filled - read, has_gap, now, temperature, out, make);
    is_uncertain_ = !result || (has_gap && !has_samples);
    if (const auto bad = std::exchange(bad_words_, 0); bad > 0) {
      out.unreadable(chip.error(Errc::bad_data, what, std::to_string(bad) + " words of its FIFO have a wrong parity",
                                "check its wires"));
    }
    return result;
  }

  /// Sleeps.
  void close(RegisterDevice& chip) {
    for (const InertialWrite& write : model_.sleeping) (void)chip.write_register(write.number, write.value);
  }

  /// `bytes`: a sample in the order of the FIFO; for tagged FIFOs angular velocity, then acceleration.
  InertialSample decode(std::span<const std::uint8_t> bytes) const noexcept {
    InertialSample sample;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      sample.acceleration[axis] = word(bytes, static_cast<std::size_t>(model_.acceleration_at) + 2 * axis) *
                                  acceleration_->per_count;
      if (model_.angle_at >= 0)
        sample.angular_velocity[axis] = word(bytes, static_cast<std::size_t>(model_.angle_at) + 2 * axis) *
                                        angle_->per_count;
    }
    if (model_.temperature_at >= 0)
      sample.temperature = degrees(bytes, static_cast<std::size_t>(model_.temperature_at));
    return sample;
  }

 private:
  static constexpr const char* what = "cannot read the inertial sensor";
  static constexpr auto settling = std::chrono::milliseconds{100};  // of the self-test's force
  static constexpr int averaged = 5;                                // samples

  /// The rate during the self-test: the lowest one from 100 Hz on, so that the test is short.
  static const InertialChoice& tested_rate(const InertialModel& model) {
    return *std::find_if(model.rates.begin(), model.rates.end(), [](const auto& one) { return one.number >= 100; });
  }
  static Duration period_of(const InertialChoice& rate) { return Duration{std::llround(1e9 / rate.number)}; }
  static Duration pause_between(Duration period) { return period + Duration{std::chrono::milliseconds{1}}; }

  static const InertialChoice* find(std::span<const InertialChoice> choices, double number) {
    for (const InertialChoice& one : choices)
      if (std::abs(one.number - number) < 1e-6) return &one;
    return nullptr;
  }
  /// The widest one when none was chosen.
  static const InertialChoice* chosen(std::span<const InertialChoice> choices, std::optional<double> number) {
    if (number) return find(choices, *number);
    const auto widest = std::max_element(choices.begin(), choices.end(),
                                         [](const auto& a, const auto& b) { return a.number < b.number; });
    return widest != choices.end() ? &*widest : nullptr;
  }
  static std::string text_of(double number) {
    std::string text = std::to_string(number);
    text.erase(text.find_last_not_of('0') + 1);
    if (text.back() == '.') text.pop_back();
    return text;
  }

  double word(std::span<const std::uint8_t> bytes, std::size_t at) const noexcept {
    const unsigned low = bytes[at + (model_.big_endian ? 1 : 0)], high = bytes[at + (model_.big_endian ? 0 : 1)];
    return static_cast<std::int16_t>(static_cast<std::uint16_t>(high << 8 | low));
  }
  double degrees(std::span<const std::uint8_t> bytes, std::size_t at) const noexcept {
    return word(bytes, at) / model_.counts_per_degree + model_.degrees_at_zero;
  }

  std::uint8_t value_of(const InertialWrite& write) const noexcept {
    return static_cast<std::uint8_t>(write.value + (is_on_spi_ ? write.on_spi : 0) + rate_->code * write.by_rate +
                                     (acceleration_ != nullptr ? acceleration_->code * write.by_acceleration : 0) +
                                     (angle_ != nullptr ? angle_->code * write.by_angle : 0) +
                                     filter_code_ * write.by_filter);
  }
  Result<void> write(RegisterDevice& chip, const InertialWrite& write) const {
    auto done = chip.write_register(write.number, value_of(write));
    if (done && write.pause > Duration{0}) chip.wait(write.pause);
    return done;
  }
  Result<void> check_chip(RegisterDevice& chip) const {
    return check_identity(chip, model_.chip, identity_, all_, "check which chip is at this address, and `model`");
  }
  /// A program that ended in the middle of setting the chip up may have left another bank.
  Result<void> choose_first_bank(RegisterDevice& chip) const {
    if (model_.bank_register == 0) return {};
    const Result<std::uint8_t> bank = chip.read_register(model_.bank_register);
    if (!bank) return bank.error();
    constexpr std::uint8_t banks = 0x30;  // other bits are set by another chip, which is left alone
    return *bank == 0 || (*bank & ~banks) != 0 ? Result<void>() : chip.write_register(model_.bank_register, 0);
  }
  /// All settings, then the FIFO.
  Result<void> set_up(RegisterDevice& chip) {
    for (const InertialWrite& one : model_.setting_up)
      if (auto done = write(chip, one); !done) return done;
    return empty_fifo(chip);
  }
  Result<void> empty_fifo(RegisterDevice& chip) {
    const InertialFifo& fifo = model_.fifo;
    if (auto done = write(chip, fifo.off); !done) return done;
    for (const InertialWrite& one : fifo.emptying)
      if (auto done = write(chip, one); !done) return done;
    if (fifo.over_register != 0) {
      if (auto cleared = chip.read_register(fifo.over_register); !cleared) return cleared.error();
    }
    auto done = write(chip, fifo.on);
    if (!done) return done;
    is_torn_ = false;
    is_uncertain_ = false;
    to_discard_ = fifo.to_discard;
    half_ = {};
    counter_.reset();
    return done;
  }

  Result<std::uint32_t> read_status(RegisterDevice& chip) const {
    std::array<std::uint8_t, 4> bytes{};
    const auto used = std::span(bytes).first(model_.fifo.status_bytes);
    if (auto done = chip.read_registers(model_.fifo.status, used); !done) return std::move(done).error();
    std::uint32_t status = 0;
    for (std::size_t i = 0; i < used.size(); ++i)
      status |= static_cast<std::uint32_t>(used[i]) << 8 * (model_.big_endian ? used.size() - 1 - i : i);
    return status;
  }
  Result<bool> has_run_over_meanwhile(RegisterDevice& chip) const {
    if (model_.fifo.over_register != 0) {
      const Result<std::uint8_t> over = chip.read_register(model_.fifo.over_register);
      if (!over) return over.error();
      return (*over & model_.fifo.over_bit) != 0;
    }
    const Result<std::uint32_t> status = read_status(chip);
    if (!status) return status.error();
    return (*status & model_.fifo.over_mask) != 0;
  }

  /// Reads whole samples (or words) into `bytes_`; `read`: the number of bytes read.
  Result<void> read_fifo(RegisterDevice& chip, std::size_t filled, std::size_t& read) {
    const InertialFifo& fifo = model_.fifo;
    constexpr std::size_t longest = 1024;  // of a transfer: what all adapters can do
    const std::size_t unit = fifo.is_tagged ? fifo.count_bytes : model_.sample_bytes;
    const std::size_t all = filled / unit * unit;
    while (read < all) {
      const auto rest = std::span(bytes_).subspan(read, all - read);
      if (fifo.is_stream) {
        const auto piece = rest.first(std::min(rest.size(), longest / unit * unit));
        if (auto done = chip.read_registers(fifo.data, piece); !done) return done;
        read += piece.size();
        continue;
      }
      const auto sample = rest.first(unit);
      if (auto done = chip.read_registers(fifo.data, sample.first(6)); !done) return done;
      if (fifo.second_data != 0) {
        if (auto done = chip.read_registers(fifo.second_data, sample.subspan(6)); !done) return done;
      }
      read += unit;
    }
    return {};
  }

  /// True if samples may be lost without an overflow flag: the FIFO was almost full while it was read, or it holds
  /// fewer samples than the chip has taken. Only once the rate is known.
  bool may_have_gap(std::size_t filled, MonotonicTime asked) {
    if (!model_.fifo.keeps_whole_samples || model_.fifo.is_tagged) return false;
    const bool is_almost_full = filled + 2 * model_.sample_bytes >= model_.fifo.capacity;
    const bool was_almost_full = std::exchange(was_almost_full_, is_almost_full);
    if (!knows_rate_) return false;
    const auto count = static_cast<std::int64_t>(filled / model_.sample_bytes);
    return is_almost_full || was_almost_full || last_ + (count + 2) * period_ < asked;
  }

  /// A sample in `bytes_` (tagged: in `joined_`): how many were left out before it, and its position.
  struct Found {
    std::size_t left_out, at;
  };
  /// The halves of a tagged sample, in the order of arrival.
  struct Half {
    std::optional<unsigned> counter;
    bool has_angle = false, has_acceleration = false;
    std::array<std::uint8_t, 12> bytes{};
  };

  /// Joins the words of a tagged FIFO to samples.
  void join(std::size_t size) {
    std::size_t to = 0;
    for (std::size_t at = 0; at + 7 <= size; at += 7) {
      const std::uint8_t tag = bytes_[at];
      const unsigned kind = tag >> 3, counter = tag >> 1 & 3;
      constexpr unsigned of_gyroscope = 1, of_accelerometer = 2;
      if (std::popcount(tag) % 2 != 0) {
        ++bad_words_;
        continue;
      }
      if (kind != of_gyroscope && kind != of_accelerometer) continue;
      if (half_.counter != counter) half_ = {counter, false, false, {}};
      std::copy_n(bytes_.begin() + static_cast<std::ptrdiff_t>(at + 1), 6,
                  half_.bytes.begin() + (kind == of_gyroscope ? 0 : 6));
      (kind == of_gyroscope ? half_.has_angle : half_.has_acceleration) = true;
      if (!half_.has_angle || !half_.has_acceleration) continue;
      std::copy(half_.bytes.begin(), half_.bytes.end(), joined_.begin() + static_cast<std::ptrdiff_t>(to));
      found_.push_back({counter_ ? (counter - *counter_ - 1) & 3 : 0, to});
      counter_ = counter;
      to += 12;
      half_ = {};
    }
  }

  /// Makes events of the `size` bytes that were read; `left` bytes are in the FIFO still. False: there was no sample.
  template <class Value, class Make>
  bool take(std::size_t size, std::size_t left, bool has_gap, MonotonicTime now, std::optional<double> temperature,
            Samples<Value>& out, const Make& make) {
    found_.clear();
    const bool knows_counter = counter_.has_value();
    if (model_.fifo.is_tagged) {
      join(size);
    } else {
      for (std::size_t at = 0; at < size; at += model_.sample_bytes) found_.push_back({0, at});
    }
    std::size_t first = 0;
    for (; to_discard_ > 0 && first < found_.size(); ++first, --to_discard_) {
      last_ += period_;
      if (!is_new_) out.lost(1);
    }
    if (to_discard_ == 0) is_new_ = false;
    if (first == found_.size()) return false;
    const std::size_t still = left / (model_.fifo.is_tagged ? std::size_t{14} : model_.sample_bytes);
    const auto samples = std::span(found_).subspan(first);
    if (has_gap) {  // the number that the chip has taken, minus those that were read
      std::int64_t taken = now > last_ ? (now - last_) / period_ : 0;
      std::int64_t gone = std::max<std::int64_t>(taken - static_cast<std::int64_t>(samples.size() + still), 0);
      if (model_.fifo.is_tagged && knows_counter) {  // the nearest number with these last two bits
        const auto bits = static_cast<std::int64_t>(samples.front().left_out);
        gone = std::max<std::int64_t>(gone - 1, 0);
        gone += (bits - gone) & 3;
      }
      out.lost(static_cast<std::uint64_t>(gone));
      last_ += gone * period_;
      samples.front().left_out = 0;
      if (gone > 0) anchor(last_);
    }
    std::size_t positions = 0;
    for (const Found& one : samples) positions += one.left_out + 1;
    const auto count = static_cast<std::int64_t>(positions + still);
    // The newest one in the FIFO is between now and one period ago.
    const MonotonicTime newest = std::clamp(last_ + count * period_, now - period_, now);
    const Duration step = std::max(newest - last_, Duration{0}) / count;
    MonotonicTime time = last_;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      out.lost(samples[i].left_out);
      time += static_cast<std::int64_t>(samples[i].left_out + 1) * step;
      InertialSample sample = decode(
          std::span(model_.fifo.is_tagged ? joined_ : bytes_).subspan(samples[i].at, model_.sample_bytes));
      if (temperature && i + 1 == samples.size()) sample.temperature = temperature;
      out.add(make(sample), time);
    }
    last_ = time;
    learn(positions);
    return true;
  }

  /// Learns the chip's period over some seconds, because each end is known only within one period.
  void learn(std::size_t positions) {
    since_anchor_ += positions;
    if (since_anchor_ < worth_learning_) return;
    const Duration measured = (last_ - anchor_) / static_cast<std::int64_t>(since_anchor_);
    knows_rate_ = true;
    period_ = std::clamp(measured, nominal_period_ * 8 / 10, nominal_period_ * 12 / 10);
    if (since_anchor_ < 10000) return;
    anchor(last_);
    worth_learning_ = 5000;  // an estimate from fewer samples would be less accurate than the current one
  }
  void anchor(MonotonicTime time) {
    anchor_ = time;
    since_anchor_ = 0;
  }
  void begin_at(MonotonicTime time) {
    last_ = time;
    anchor(time);
  }

  /// Counts as lost the samples that the chip has taken since the last one that was read. It counts whole periods and
  /// carries the rest over, so that in the long run no sample is counted twice or left out.
  template <class Value>
  void give_up_samples(MonotonicTime now, Samples<Value>& out) {
    if (now <= last_) return;
    const auto count = (now - last_) / period_;
    out.lost(static_cast<std::uint64_t>(count));
    last_ += count * period_;
    anchor(last_);
  }
  /// Empties the FIFO when it is unknown where a sample begins.
  template <class Value>
  Result<void> restart(RegisterDevice& chip, Samples<Value>& out) {
    auto begun = empty_fifo(chip);
    if (begun) give_up_samples(Samples<Value>::now(), out);
    return begun;  // otherwise the next read does it
  }

  using Six = std::array<double, 6>;
  /// Acceleration and angular velocity, averaged over some samples.
  Result<Six> average(RegisterDevice& chip) {
    const InertialSelfTest& test = model_.self_test;
    Six sum{};
    for (int i = 0; i < averaged; ++i) {
      chip.wait(pause_between(period_));
      std::array<std::uint8_t, 6> bytes{};
      if (auto done = chip.read_registers(test.acceleration_output, bytes); !done) return std::move(done).error();
      for (std::size_t axis = 0; axis < 3; ++axis)
        sum[axis] += word(bytes, 2 * axis) * acceleration_->per_count / averaged;
      if (test.angle_on == 0) continue;
      if (auto done = chip.read_registers(test.angle_output, bytes); !done) return std::move(done).error();
      for (std::size_t axis = 0; axis < 3; ++axis)
        sum[3 + axis] += word(bytes, 2 * axis) * angle_->per_count / averaged;
    }
    return sum;
  }
  /// Compares the outputs without and with the self-test deflection.
  Result<void> test(RegisterDevice& chip) {
    const InertialSelfTest& test = model_.self_test;
    // Uses the ranges for which the data sheet gives the limits.
    const auto* acceleration = std::exchange(acceleration_, find(model_.accelerations, test.acceleration_range));
    const auto* angle = std::exchange(angle_, find(model_.angles, test.angle_range));
    const auto* rate = std::exchange(rate_, &tested_rate(model_));
    const Duration period = std::exchange(period_, period_of(*rate_));
    auto passed = test_at_these_ranges(chip);
    acceleration_ = acceleration;
    angle_ = angle;
    rate_ = rate;
    period_ = period;
    return passed;
  }
  Result<void> test_at_these_ranges(RegisterDevice& chip) {
    const InertialSelfTest& test = model_.self_test;
    for (const InertialWrite& one : model_.setting_up)
      if (auto done = write(chip, one); !done) return done;
    if (auto done = write(chip, model_.fifo.off); !done) return done;
    chip.wait(settling);
    const Result<Six> before = average(chip);
    if (!before) return before.error();
    const auto change = [&](std::uint8_t number, std::uint8_t bits) -> Result<void> {
      if (bits == 0) return {};
      const Result<std::uint8_t> value = chip.read_register(number);
      if (!value) return value.error();
      return chip.write_register(number, static_cast<std::uint8_t>(*value ^ bits));
    };
    if (auto done = change(test.acceleration_register, test.acceleration_on); !done) return done;
    if (auto done = change(test.angle_register, test.angle_on); !done) return done;
    chip.wait(settling);
    const Result<Six> after = average(chip);
    if (!after) return after.error();
    if (auto done = change(test.acceleration_register, test.acceleration_on); !done) return done;
    if (auto done = change(test.angle_register, test.angle_on); !done) return done;
    const Result<InertialSixLimits> limits = test.limits_of != nullptr ? test.limits_of(chip) : test.limits;
    if (!limits) return limits.error();
    for (std::size_t i = 0; i < (test.angle_on != 0 ? 6u : 3u); ++i) {
      const double by = std::abs((*after)[i] - (*before)[i]);
      const auto [least, most] = (*limits)[i];
      if (by >= least && by <= most) continue;
      const char* unit = i < 3 ? " m/s2" : " rad/s";
      return chip.error(Errc::out_of_range, "the self-test of the " + std::string(model_.chip.name) + " failed",
                        std::string(i < 3 ? "its acceleration " : "its angular velocity ") + "xyz"[i % 3] +
                            " changes by " + text_of(by) + unit + ", not by " + text_of(least) + " to " + text_of(most),
                        "keep it still while it starts; if this repeats, the chip is damaged");
    }
    return {};
  }

  const InertialModel& model_;
  std::span<const InertialModel> all_;
  bool is_tested_;
  std::optional<IdentityCode> identity_;
  bool is_on_spi_ = false;
  const InertialChoice* rate_ = nullptr;
  const InertialChoice* acceleration_ = nullptr;
  const InertialChoice* angle_ = nullptr;
  std::uint8_t filter_code_ = 0;
  Duration nominal_period_{0}, period_{0};
  MonotonicTime last_{};    // of the last sample that was read, or of the start
  MonotonicTime anchor_{};  // from which the period is measured
  std::size_t since_anchor_ = 0, worth_learning_ = 500;
  bool knows_rate_ = false, was_almost_full_ = false;
  bool is_torn_ = false;       // it is unknown where a sample begins in the FIFO
  bool is_uncertain_ = false;  // a transfer failed in the middle
  bool is_new_ = true;         // nothing was read yet
  bool is_open_ = false;
  InertialMemory before_;     // from the driver object that was replaced
  std::uint64_t unread_ = 0;  // samples between that and the opening
  unsigned to_discard_ = 0;
  std::vector<std::uint8_t> bytes_, joined_;
  std::vector<Found> found_;
  std::size_t bad_words_ = 0;
  Half half_;
  std::optional<unsigned> counter_;  // of the last tagged sample
};

/// The common part of the drivers of these chips. `C`: the configuration, with `models()`, `chip()` (one of them) and
/// `settings()`. `Reading`: the payload, made by `Reading::of(const InertialSample&)`.
template <class C, class Reading>
class InertialDriver {
 public:
  using Config = C;
  using Value = Reading;
  using Device = RegisterDevice;
  using Memory = InertialMemory;
  static RegisterAddressing addressing(const C& config) { return config.chip().addressing; }

  /// SetupError (bad-argument): a setting that the chip does not have.
  explicit InertialDriver(const C& config) : chip_(chip_of(config)) {}
  static double sample_rate(const C& config) { return chip_of(config).sample_rate(); }
  static std::size_t fifo_samples(const C& config) { return chip_of(config).fifo_samples(); }
  static Duration bus_time(const C& config) { return InertialChip::bus_time(config.chip(), config.settings()); }

  Result<void> open(RegisterDevice& chip) { return chip_.open(chip); }
  Result<void> read(RegisterDevice& chip, Samples<Reading>& out) { return chip_.read(chip, out, &Reading::of); }
  void close(RegisterDevice& chip) { chip_.close(chip); }
  Memory memory() const noexcept { return chip_.memory(); }
  void remember(const Memory& memory) noexcept { chip_.remember(memory); }
  static std::uint64_t unread(const Memory& memory, MonotonicTime now) noexcept { return memory.periods_until(now); }

  static Reading decode(std::span<const std::uint8_t> bytes, const C& config) {
    return Reading::of(chip_of(config).decode(bytes));
  }

 private:
  static InertialChip chip_of(const C& config) { return {config.chip(), C::models(), config.settings()}; }
  InertialChip chip_;
};

}  // namespace rtdata
