// A topic's rows reduced to steps: of each number how many values there are, the least, the largest and the mean.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>

#include "data/lower_case.hpp"
#include "sinks/sqlite/rows_merge.hpp"

namespace rtdata::detail {
namespace {

bool is_number(Kind kind) noexcept {
  return kind != Kind::text && kind != Kind::character && kind != Kind::enumeration && kind != Kind::record;
}

bool is_float(Kind kind) noexcept { return kind == Kind::f64 || kind == Kind::f32; }

/// What a field becomes of which there are floating-point numbers: its sum stays finite as long as they are.
struct Reals {
  double min = std::numeric_limits<double>::infinity();
  double max = -std::numeric_limits<double>::infinity();
  double sum = 0;  // times `scale`
  double scale = 1;

  void add(double value) noexcept {
    if (!std::isfinite(sum + value * scale)) [[unlikely]] {
      constexpr double small = 0x1p-64;  // more values than a step can have
      if (scale == 1) sum *= small;
      scale = small;
    }
    sum += value * scale;
    min = value < min ? value : min;
    max = value > max ? value : max;
  }
  double mean(std::uint64_t count) const noexcept { return sum / static_cast<double>(count) / scale; }
};

/// What a field becomes of which there are integers. Those of 64 bits without a sign are kept with the first bit turned
/// over, so that one order holds for all.
struct Integers {
  std::int64_t min = std::numeric_limits<std::int64_t>::max();
  std::int64_t max = std::numeric_limits<std::int64_t>::min();
  std::uint64_t low = 0;  // the sum is high * 2^64 + low
  std::int64_t high = 0;

  static std::int64_t turned(std::int64_t value) noexcept { return value ^ std::numeric_limits<std::int64_t>::min(); }

  void add(std::int64_t value, bool is_unsigned) noexcept {
    const auto bits = static_cast<std::uint64_t>(value);
    low += bits;
    high += (low < bits ? 1 : 0) - (value < 0 && !is_unsigned ? 1 : 0);
    const std::int64_t kept = is_unsigned ? turned(value) : value;
    min = std::min(min, kept);
    max = std::max(max, kept);
  }
  static Value value(std::int64_t kept, bool is_unsigned) {
    return is_unsigned ? Value{static_cast<std::uint64_t>(turned(kept))} : Value{kept};
  }
  double mean(std::uint64_t count) const noexcept {
    const bool is_negative = high < 0;  // then its opposite is added up: the two parts have one sign
    const std::uint64_t units = is_negative ? 0 - low : low;
    const std::int64_t twos = is_negative ? -high - (low != 0 ? 1 : 0) : high;
    const double sum = std::ldexp(static_cast<double>(twos), 64) + static_cast<double>(units);
    return (is_negative ? -sum : sum) / static_cast<double>(count);
  }
};

struct Statistics {
  std::uint64_t count = 0;
  Reals reals;
  Integers integers;
};

std::shared_ptr<const Description> statistics_of(const Field& field) {
  constexpr auto optional = DescriptionBuilder::Presence::optional;
  const Kind kind = field.kind == Kind::boolean ? Kind::u8 : field.kind;
  return DescriptionBuilder("statistics")
      .field("count", Kind::u64)
      .field("min", kind, field.unit, optional)
      .field("max", kind, field.unit, optional)
      .field("mean", Kind::f64, field.unit, optional)
      .build()
      .or_throw();
}

/// Of one record.
class Names {
 public:
  /// The name, or with `_` behind it until no other has it.
  std::string free(std::string name) {
    while (!taken_.insert(lower_case(name)).second) name += '_';
    return name;
  }

 private:
  std::set<std::string> taken_;
};

/// What a field becomes; null: nothing, since there is no number in it.
std::shared_ptr<const Description> steps_of(const Field& field);

/// Adds what the fields become; returns whether there is any. `own`, where it is not empty, is a field of the row
/// itself, which comes first; the fields keep their names before it, and those without a point before those with one.
bool add_fields(DescriptionBuilder& builder, const std::vector<Field>& fields, const std::string& own = "") {
  struct Part {
    const Field* field;
    std::shared_ptr<const Description> steps;
    std::string name;
  };
  std::vector<Part> parts;
  for (const Field& field : fields) {
    auto steps = steps_of(field);
    if (steps != nullptr) parts.push_back({&field, std::move(steps), field.name});
  }
  Names names;
  const auto has_point = [](const Part& part) { return part.name.find('.') != std::string::npos; };
  for (Part& part : parts)
    if (!has_point(part)) part.name = names.free(std::move(part.name));
  for (Part& part : parts) {
    if (!has_point(part)) continue;
    // "pressure.raw" beside "pressure": a point is in no name of a record.
    std::replace(part.name.begin(), part.name.end(), '.', '_');
    part.name = names.free(std::move(part.name));
  }
  if (!own.empty()) builder.field(names.free(own), Kind::u64);
  for (Part& part : parts) {
    if (part.field->is_array) {
      builder.record_array(std::move(part.name), *part.steps, part.field->count);
    } else {
      builder.record(std::move(part.name), *part.steps);
    }
  }
  return !parts.empty();
}

std::shared_ptr<const Description> steps_of(const Field& field) {
  std::shared_ptr<const Description> none;
  if (field.kind != Kind::record) return is_number(field.kind) ? statistics_of(field) : none;
  DescriptionBuilder nested(field.name);
  auto has_any = add_fields(nested, field.fields);
  return has_any ? nested.build().or_throw() : none;
}

std::shared_ptr<const Description> description_of_steps(const Description& of) {
  DescriptionBuilder builder(of.name() + "_steps");
  add_fields(builder, of.fields(), "events");
  return builder.build().or_throw();
}

class StepCursor final : public RowCursor {
 public:
  StepCursor(const Recording& recording, RecordedTopic topic, std::shared_ptr<const Description> steps,
             std::vector<const Leaf*> leaves, sqlite::Statement statement, RowFilter::Times times, Duration step)
      : file_(recording.file()),
        topic_(std::move(topic)),
        leaves_(std::move(leaves)),
        statement_(std::move(statement)),
        times_(times),
        step_(step.count()) {
    out_ = topic_;
    out_.description = std::move(steps);
    for (const Leaf* leaf : leaves_) kinds_.push_back(leaf->kind);
  }

  bool advance() override {
    if (next_ready_ == ready_.size()) {
      if (!read_step()) return false;
    }
    run = run_of_step_;
    time = begin_;
    return true;
  }

  void give(RecordedRow& row) override {
    Origin& origin = origins_[ready_[next_ready_++]];
    std::byte* const payload = set_event(row, origin.name, ++origin.sequence, out_);
    std::fill(payload, payload + out_.description->size(), std::byte{0});
    const auto& leaves = out_.description->leaves();
    (void)write(leaves[0], payload, Value{origin.events});
    for (std::size_t i = 0; i < kinds_.size(); ++i) {
      const Statistics& of = origin.statistics[i];
      const Leaf* const to = &leaves[1 + 4 * i];
      (void)write(to[0], payload, Value{of.count});
      if (of.count == 0) continue;
      const bool is_unsigned = kinds_[i] == Kind::u64;
      const bool has_reals = is_float(kinds_[i]);
      const Value least = has_reals ? Value{of.reals.min} : Integers::value(of.integers.min, is_unsigned);
      const Value most = has_reals ? Value{of.reals.max} : Integers::value(of.integers.max, is_unsigned);
      for (const auto& done : {write(to[1], payload, least), write(to[2], payload, most)}) {
        done.or_throw();
      }
      (void)write(to[3], payload, Value{has_reals ? of.reals.mean(of.count) : of.integers.mean(of.count)});
    }
  }

 private:
  struct Origin {
    std::string name;
    std::uint64_t sequence = 0;  // of the last step
    std::uint64_t events = 0;    // in this step
    std::vector<Statistics> statistics;
  };

  /// Reads the next step that has rows. False: there is none.
  bool read_step() {
    ready_.clear();
    next_ready_ = 0;
    if (!is_begun_) {
      const bool more = statement_.step();
      is_begun_ = true;
      has_row_ = more;
    }
    if (!has_row_) return false;
    if (const std::int64_t row_run = statement_.integer(run_column); row_run != run_of_step_ || !has_line_) {
      begin_run(row_run);
    }
    for (Origin& origin : origins_) {
      origin.events = 0;
      std::fill(origin.statistics.begin(), origin.statistics.end(), Statistics{});
    }
    const std::int64_t end = begin_step(statement_.integer(time_column));
    do {
      add_row();
      has_row_ = statement_.step();
    } while (has_row_ && statement_.integer(run_column) == run_of_step_ && statement_.integer(time_column) < end);
    for (std::size_t i = 0; i < origins_.size(); ++i)
      if (origins_[i].events != 0) ready_.push_back(i);
    std::sort(ready_.begin(), ready_.end(),
              [this](std::size_t a, std::size_t b) { return origins_[a].name < origins_[b].name; });
    return true;
  }

  void begin_run(std::int64_t row_run) {
    run_of_step_ = row_run;
    has_line_ = true;
    origins_.clear();
    current_ = 0;
    if (times_ == RowFilter::Times::recorded) return;
    line_ = utc_line_of(*file_, row_run);
  }

  /// Sets the beginning of the step with this recorded time; returns its end on the recorded line.
  std::int64_t begin_step(std::int64_t recorded) {
    const bool is_utc = times_ == RowFilter::Times::utc;
    const std::int64_t at = is_utc ? to_nanoseconds(line_.utc(from_nanoseconds(recorded))) : recorded;
    const std::int64_t rest = (at % step_ + step_) % step_;
    begin_ = at < std::numeric_limits<std::int64_t>::min() + rest ? at : at - rest;
    if (begin_ > std::numeric_limits<std::int64_t>::max() - step_) return std::numeric_limits<std::int64_t>::max();
    const std::int64_t end = begin_ + step_;
    return is_utc ? std::max(to_nanoseconds(line_.recorded(from_nanoseconds(end))), recorded + 1) : end;
  }

  void add_row() {
    const std::string_view name = statement_.text(origin_column);
    if (current_ >= origins_.size() || origins_[current_].name != name) {
      current_ = static_cast<std::size_t>(
          std::find_if(origins_.begin(), origins_.end(), [&](const Origin& origin) { return origin.name == name; }) -
          origins_.begin());
      if (current_ == origins_.size())
        origins_.push_back({std::string(name), 0, 0, std::vector<Statistics>(kinds_.size())});
    }
    Origin& origin = origins_[current_];
    ++origin.events;
    sqlite3_stmt* const row = statement_.raw();
    for (std::size_t i = 0; i < kinds_.size(); ++i) {
      sqlite3_value* const value = sqlite3_column_value(row, fixed_columns + static_cast<int>(i));
      const int type = sqlite3_value_type(value);
      const bool has_reals = is_float(kinds_[i]);
      Statistics& of = origin.statistics[i];
      if (has_reals && (type == SQLITE_FLOAT || type == SQLITE_INTEGER)) {
        ++of.count;
        of.reals.add(sqlite3_value_double(value));
      } else if (type == SQLITE_INTEGER) {
        ++of.count;
        of.integers.add(sqlite3_value_int64(value), kinds_[i] == Kind::u64);
      } else if (type != SQLITE_NULL && !(type == SQLITE_TEXT && has_reals)) {
        throw SetupError(at_row(*file_, topic_, run_of_step_, origin.name,
                                static_cast<std::uint64_t>(statement_.integer(sequence_column)),
                                {Errc::damaged, "cannot read a row", "field " + leaves_[i]->path,
                                 "it holds what is no " + std::string(name_of(kinds_[i])), ""}));
      }
    }
  }

  const std::shared_ptr<RecordingFile> file_;
  const RecordedTopic topic_;
  RecordedTopic out_;
  const std::vector<const Leaf*> leaves_;  // that are numbers
  std::vector<Kind> kinds_;                // of these
  sqlite::Statement statement_;
  const RowFilter::Times times_;
  const std::int64_t step_;
  UtcLine line_{{}};
  bool is_begun_ = false;
  bool has_line_ = false;
  bool has_row_ = false;  // the statement is at one that is in no step yet
  std::int64_t run_of_step_ = 0;
  std::int64_t begin_ = 0;
  std::vector<Origin> origins_;  // of the run
  std::size_t current_ = 0;      // of the last row
  std::vector<std::size_t> ready_;
  std::size_t next_ready_ = 0;
};

}  // namespace

std::unique_ptr<RowCursor> make_step_cursor(const Recording& recording, RecordedTopic topic, const Selection& selection,
                                            Duration step) {
  auto steps = description_of_steps(*topic.description);
  std::vector<const Leaf*> leaves;
  std::string columns;
  for (const Leaf& leaf : topic.description->leaves()) {
    if (!is_number(leaf.kind)) continue;
    leaves.push_back(&leaf);
    columns += ", t." + sqlite::quoted(leaf.path);
  }
  auto statement = rows_in_order(*recording.file(), topic, selection, columns);
  return std::unique_ptr<RowCursor>(std::make_unique<StepCursor>(recording, std::move(topic), std::move(steps),
                                                                 std::move(leaves), std::move(statement),
                                                                 selection.filter.times, step));
}

}  // namespace rtdata::detail
