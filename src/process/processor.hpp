// Processor: applies the processing to each sample of one sensor.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/process/processing.hpp"

namespace rtdata::detail {

/// All memory is allocated at construction. Thread: the loop's of its sensor.
class Processor {
 public:
  /// `source`: what the sensor gives. ProcessingError.
  Processor(std::shared_ptr<const Description> source, const Processing& processing, const std::string& sensor);

  const std::shared_ptr<const Description>& source() const noexcept { return source_; }
  const std::shared_ptr<const Description>& published() const noexcept { return published_; }

  enum class Fate : std::uint8_t { published, filtered, unusable };
  /// `payload`: the sensor's; afterwards, for a published sample, the published payload, valid until the next call.
  /// `breaks`: the number of gaps and faults so far; a change restarts the filters.
  Fate take(void*& payload, Time time, std::uint64_t breaks) noexcept;
  /// The next sample is the first one.
  void restart() noexcept;
  /// Why the last sample was unusable.
  Error error(const std::string& sensor) const;

 private:
  enum class OpKind : std::uint8_t {
    scale,
    line,
    polynomial,
    table,
    bounds,
    tare,
    median,
    mean,
    exponential,
    clamp,
    throttle,
    delta,
    rate,
  };
  enum class Reference : std::uint8_t { none, absent, value };
  /// One step of the values of a group, and what it remembers; numbers of each value lie side by side.
  struct Op {
    OpKind step = OpKind::scale;
    OutsideTable outside = OutsideTable::refuse;
    Reference reference = Reference::none;
    bool is_absent = false;    // in this sample
    std::uint32_t count = 0;   // of coefficients, points, samples
    std::uint32_t filled = 0;  // of samples
    std::uint32_t at = 0;      // the place of the next one
    std::size_t first = 0;     // of its numbers
    Time last_time{};
    Time time_before{};
    Duration time{0};
  };
  /// Values that go through the same steps, side by side: dispatching costs the group no more than one value. An
  /// optional value has its own group.
  struct Group {
    Kind from = Kind::f64;
    Kind to = Kind::f64;
    bool is_written = false;
    bool decides = false;
    bool from_is_row = false;  // doubles one behind the other
    bool to_is_row = false;
    const OptionalAccess* from_optional = nullptr;
    const OptionalAccess* to_optional = nullptr;
    const OptionalAccess* rate_optional = nullptr;  // null: it has none
    std::size_t first = 0;                          // of its lanes
    std::size_t count = 0;
    std::size_t first_op = 0;
    std::size_t end_op = 0;
  };
  struct Lane {
    std::size_t from = 0;
    std::size_t to = 0;
    std::size_t rate = 0;
    std::size_t leaf = 0;  // its number in the source
  };
  struct Copy {
    std::size_t from, to, size;
  };
  enum class Failure : std::uint8_t { raw_not_finite, not_finite, outside_table, below, above };
  struct Item {
    const Leaf* leaf;
    const std::string* path;
    const FieldProcessing* what;
  };

  void plan_copies();
  void add_copy(const Leaf& from, const Leaf& to);
  void add_group(const std::vector<Item>& items);
  Op& add_op(OpKind step, std::size_t numbers);
  /// False: a value is unusable. `is_wanted` becomes true if a field with `throttle` or `delta` lets the sample pass.
  bool run(Group& group, const std::byte* payload, Time time, bool& is_wanted) noexcept;
  void pass_absent(Group& group, bool& is_wanted) noexcept;
  bool fail(const Group& group, std::size_t lane, Failure failure, double value, double bound = 0) noexcept;
  bool check_finite(const Group& group) noexcept;
  bool look_up(const Group& group, Op& op) noexcept;
  bool check_bounds(const Group& group, const Op& op) noexcept;
  void take_medians(std::size_t lanes, Op& op) noexcept;
  void take_means(std::size_t lanes, Op& op) noexcept;
  bool put_rates(const Group& group, Op& op) noexcept;
  bool put(const Group& group) noexcept;

  std::shared_ptr<const Description> source_;
  std::shared_ptr<const Description> published_;
  std::vector<Group> groups_;
  std::vector<Lane> lanes_;
  std::vector<Op> ops_;
  std::vector<double> numbers_;
  std::vector<double> x_;             // of the group under way
  std::vector<std::uint8_t> passes_;  // of each of these
  std::vector<Copy> copies_;
  std::vector<std::byte> payload_;  // that is published; empty: the sensor's is
  std::size_t shift_ = 0;           // in it, to where it is aligned
  std::byte* out_ = nullptr;
  std::uint64_t breaks_ = 0;
  Time last_time_ = Time::min();
  Time instant_ = Time::min();  // of the sample: the time of the first that is nearer to it than `one_instant`
  bool decides_ = false;        // a value may hold a sample back
  std::size_t failed_leaf_ = 0;
  Failure failure_{};
  double failed_value_ = 0;
  double failed_bound_ = 0;
};

/// For recordings: {"topic": ..., "fields": {NAME: {"version": ..., "calibration": {...}, "filters": [...]}}}.
std::string text_of(const Processing& processing, std::string_view topic);

}  // namespace rtdata::detail
