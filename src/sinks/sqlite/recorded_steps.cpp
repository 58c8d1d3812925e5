// A topic's rows reduced to steps: of each number how many values there are, the least, the largest and the mean.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>

#include "sinks/sqlite/rows_merge.hpp"

namespace rtdata::detail {
namespace {

bool is_number(Kind kind) noexcept {
  return kind != Kind::text && kind != Kind::character && kind != Kind::enumeration && kind != Kind::record;
}

/// What a number becomes.
struct Statistics {
  std::uint64_t count = 0;
  double min = std::numeric_limits<double>::infinity();
  double max = -std::numeric_limits<double>::infinity();
  double sum = 0;

  void add(double value) noexcept {
    ++count;
    sum += value;
    min = value < min ? value : min;
    max = value > max ? value : max;
  }
};

Result<std::shared_ptr<const Description>> statistics_of(const std::string& unit) {
  constexpr auto optional = DescriptionBuilder::Presence::optional;
  return DescriptionBuilder("statistics")
      .field("count", Kind::u64)
      .field("min", Kind::f64, unit, optional)
      .field("max", Kind::f64, unit, optional)
      .field("mean", Kind::f64, unit, optional)
      .build();
}

/// Of one record: as SQLite compares names, without the case of the letters of ASCII.
class Names {
 public:
  /// The name, or with `_` behind it until no other has it.
  std::string free(std::string name) {
    while (!taken_.insert(lower(name)).second) name += '_';
    return name;
  }

 private:
  static std::string lower(std::string name) {
    for (char& c : name) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
    return name;
  }
  std::set<std::string> taken_;
};

/// What a field becomes; null: nothing, since there is no number in it.
Result<std::shared_ptr<const Description>> steps_of(const Field& field);

/// Adds what the fields become; returns whether there is any. `own`, where it is not empty, is a field of the row
/// itself, which comes first; the fields keep their names before it, and those without a point before those with one.
Result<bool> add_fields(DescriptionBuilder& builder, const std::vector<Field>& fields, const std::string& own = "") {
  struct Part {
    const Field* field;
    std::shared_ptr<const Description> steps;
    std::string name;
  };
  std::vector<Part> parts;
  for (const Field& field : fields) {
    auto steps = steps_of(field);
    if (!steps) return std::move(steps).error();
    if (*steps != nullptr) parts.push_back({&field, *std::move(steps), field.name});
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

Result<std::shared_ptr<const Description>> steps_of(const Field& field) {
  std::shared_ptr<const Description> none;
  if (field.kind != Kind::record) return is_number(field.kind) ? statistics_of(field.unit) : none;
  DescriptionBuilder nested(field.name);
  auto has_any = add_fields(nested, field.fields);
  if (!has_any) return std::move(has_any).error();
  return *has_any ? nested.build() : none;
}

Result<std::shared_ptr<const Description>> description_of_steps(const Description& of) {
  DescriptionBuilder builder(of.name() + "_steps");
  if (auto added = add_fields(builder, of.fields(), "events"); !added) return std::move(added).error();
  return builder.build();
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

  Result<bool> advance() override {
    if (next_ready_ == ready_.size()) {
      auto read = read_step();
      if (!read || !*read) return read;
    }
    run = run_of_step_;
    time = begin_;
    return true;
  }

  Result<void> give(RecordedRow& row) override {
    Origin& origin = origins_[ready_[next_ready_++]];
    std::byte* const payload = set_event(row, origin.name, ++origin.sequence, out_);
    std::fill(payload, payload + out_.description->size(), std::byte{0});
    const auto& leaves = out_.description->leaves();
    (void)write(leaves[0], payload, Value{origin.events});
    std::size_t at = 1;
    for (const Statistics& of : origin.statistics) {
      (void)write(leaves[at], payload, Value{of.count});
      if (of.count != 0) {
        (void)write(leaves[at + 1], payload, Value{of.min});
        (void)write(leaves[at + 2], payload, Value{of.max});
        (void)write(leaves[at + 3], payload, Value{of.sum / static_cast<double>(of.count)});
      }
      at += 4;
    }
    return {};
  }

 private:
  struct Origin {
    std::string name;
    std::uint64_t sequence = 0;  // of the last step
    std::uint64_t events = 0;    // in this step
    std::vector<Statistics> statistics;
  };

  /// Reads the next step that has rows. False: there is none.
  Result<bool> read_step() {
    ready_.clear();
    next_ready_ = 0;
    if (!is_begun_) {
      auto more = statement_.step();
      if (!more) return more;
      is_begun_ = true;
      has_row_ = *more;
    }
    if (!has_row_) return false;
    if (const std::int64_t row_run = statement_.integer(run_column); row_run != run_of_step_ || !has_line_) {
      if (auto begun = begin_run(row_run); !begun) return std::move(begun).error();
    }
    for (Origin& origin : origins_) {
      origin.events = 0;
      std::fill(origin.statistics.begin(), origin.statistics.end(), Statistics{});
    }
    const std::int64_t end = begin_step(statement_.integer(time_column));
    do {
      if (auto added = add_row(); !added) return std::move(added).error();
      auto more = statement_.step();
      if (!more) return more;
      has_row_ = *more;
    } while (has_row_ && statement_.integer(run_column) == run_of_step_ && statement_.integer(time_column) < end);
    for (std::size_t i = 0; i < origins_.size(); ++i)
      if (origins_[i].events != 0) ready_.push_back(i);
    std::sort(ready_.begin(), ready_.end(),
              [this](std::size_t a, std::size_t b) { return origins_[a].name < origins_[b].name; });
    return true;
  }

  Result<void> begin_run(std::int64_t row_run) {
    run_of_step_ = row_run;
    has_line_ = true;
    origins_.clear();
    current_ = 0;
    if (times_ == RowFilter::Times::recorded) return {};
    auto line = utc_line_of(*file_, row_run);
    if (!line) return std::move(line).error();
    line_ = *std::move(line);
    return {};
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

  Result<void> add_row() {
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
      const bool is_float = kinds_[i] == Kind::f64 || kinds_[i] == Kind::f32;
      if (type == SQLITE_FLOAT && is_float) {
        origin.statistics[i].add(sqlite3_value_double(value));
      } else if (type == SQLITE_INTEGER) {
        const std::int64_t number = sqlite3_value_int64(value);
        origin.statistics[i].add(kinds_[i] == Kind::u64 ? static_cast<double>(static_cast<std::uint64_t>(number))
                                                        : static_cast<double>(number));
      } else if (type != SQLITE_NULL && !(type == SQLITE_TEXT && is_float)) {
        return at_row(*file_, topic_, run_of_step_, origin.name,
                      static_cast<std::uint64_t>(statement_.integer(sequence_column)),
                      {Errc::damaged, "cannot read a row", "field " + leaves_[i]->path,
                       "it holds what is no " + std::string(name_of(kinds_[i])), ""});
      }
    }
    return {};
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

Result<std::unique_ptr<RowCursor>> make_step_cursor(const Recording& recording, RecordedTopic topic,
                                                    const Selection& selection, Duration step) {
  auto steps = description_of_steps(*topic.description);
  if (!steps) return std::move(steps).error();
  std::vector<const Leaf*> leaves;
  std::string columns;
  for (const Leaf& leaf : topic.description->leaves()) {
    if (!is_number(leaf.kind)) continue;
    leaves.push_back(&leaf);
    columns += ", t." + sqlite::quoted(leaf.path);
  }
  auto statement = rows_in_order(*recording.file(), topic, selection, columns);
  if (!statement) return std::move(statement).error();
  return std::unique_ptr<RowCursor>(std::make_unique<StepCursor>(recording, std::move(topic), *std::move(steps),
                                                                 std::move(leaves), *std::move(statement),
                                                                 selection.filter.times, step));
}

}  // namespace rtdata::detail
