// Reduces a topic's rows to steps: count, minimum, maximum and mean of each number. Recorded steps of a second or a
// minute are read instead of the rows where they add up to the steps that are asked for.
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "data/lower_case.hpp"
#include "recording/rows_merge.hpp"
#include "recording/step.hpp"

namespace rtdata::detail {
namespace {

using sqlite::is_number;

bool is_float(Kind kind) noexcept { return kind == Kind::f64 || kind == Kind::f32; }

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
    // "pressure.raw" beside "pressure": no field of a record has a point in its name.
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

/// What SQL needs to know of the steps: a query gives it to `step_of`, by a pointer.
struct Steps {
  static constexpr const char* pointer_type = "rtdata steps";
  std::int64_t step;
  RowFilter::Times times;
  std::map<std::int64_t, UtcLine> lines;  // by run, when the steps are those of UTC
};

/// rtdata_step(steps, run, time): the number of the step since the epoch.
void step_of(sqlite3_context* context, int, sqlite3_value** arguments) noexcept {
  const auto* const steps = static_cast<const Steps*>(sqlite3_value_pointer(arguments[0], Steps::pointer_type));
  if (steps == nullptr) return sqlite3_result_error(context, "rtdata_step is not for use in SQL", -1);
  std::int64_t time = sqlite3_value_int64(arguments[2]);
  const auto line = steps->lines.find(sqlite3_value_int64(arguments[1]));
  if (line != steps->lines.end()) time = to_nanoseconds(line->second.utc(from_nanoseconds(time)));
  sqlite3_result_int64(context, time / steps->step - (time % steps->step < 0 ? 1 : 0));
}

/// One with another order of the bits, by which unsigned numbers of 64 bits are in order: as it is stored, or read.
std::int64_t turned(std::int64_t value) noexcept { return value ^ std::numeric_limits<std::int64_t>::min(); }

class StepCursor final : public RowCursor {
 public:
  StepCursor(const Recording& recording, RecordedTopic topic, const Selection& selection, Duration step)
      : file_(recording.file()), topic_(std::move(topic)), out_(topic_), selection_(selection) {
    steps_ = {step.count(), selection.filter.times, {}};
    if (steps_.times == RowFilter::Times::utc)
      for (const RunInfo& one : recording.runs().or_throw())
        steps_.lines.emplace(one.run, utc_line_of(*file_, one.run));
    out_.description = description_of_steps(*topic_.description);
    for (const Leaf& leaf : topic_.description->leaves())
      if (is_number(leaf.kind)) leaves_.push_back(&leaf);
    const sqlite::StepLength* const recorded = recorded_steps();
    for (std::size_t first = 0; first == 0 || first < leaves_.size(); first += leaves_at_once) {
      const std::string from = recorded != nullptr ? of_recorded(*recorded) : of_rows(first);
      statements_.push_back(file_->prepare(from + " GROUP BY 1, 2, 3 ORDER BY 1, 2, 3"));
      bind(statements_.back());
    }
  }

  bool advance() override {
    bool has_row = false;
    for (sqlite::Statement& statement : statements_) has_row = statement.step();  // all give the same steps
    if (!has_row) return false;
    const sqlite::Statement& first = statements_.front();
    if (std::exchange(run, first.integer(0)) != first.integer(0)) sequences_.clear();
    if (__builtin_mul_overflow(first.integer(1), steps_.step, &time)) time = std::numeric_limits<std::int64_t>::min();
    for (std::size_t i = 0; i < leaves_.size(); ++i) {
      const auto [row, column] = place_of(i);
      const int type = sqlite3_column_type(row.raw(), column + most_column);  // of texts and blobs, too
      if (row.integer(column + odd_column) != 0 || type == SQLITE_TEXT || type == SQLITE_BLOB) tell_odd(*leaves_[i]);
    }
    return true;
  }

  void give(RecordedRow& row) override {
    const sqlite::Statement& first = statements_.front();
    const std::string_view origin = first.text(2);
    std::byte* const payload = set_event(row, origin, ++sequences_[std::string(origin)], out_);
    set_sequences(row, static_cast<std::uint64_t>(first.integer(first_column)),
                  static_cast<std::uint64_t>(first.integer(first_column + 1)));
    std::fill(payload, payload + out_.description->size(), std::byte{0});
    const Leaf* to = out_.description->leaves().data();
    const auto put = [&](const Value& value) { write(*to++, payload, value).or_throw(); };
    put(first.integer(3));
    for (std::size_t i = 0; i < leaves_.size(); ++i) {
      const auto [of, column] = place_of(i);
      put(of.integer(column));
      if (of.integer(column) == 0) {
        to += 3;
      } else if (is_float(leaves_[i]->kind)) {
        put(of.real(column + least_column));
        put(of.real(column + most_column));
        // The sum was rounded.
        put(std::clamp(mean(*leaves_[i], of, column), of.real(column + least_column), of.real(column + most_column)));
      } else {
        const bool is_unsigned = leaves_[i]->kind == Kind::u64;
        for (const int one : {least_column, most_column}) {
          const std::int64_t value = of.integer(column + one);
          put(is_unsigned ? Value{static_cast<std::uint64_t>(turned(value))} : Value{value});
        }
        put(of.real(column + mean_column));
      }
    }
  }

 private:
  static constexpr std::size_t leaves_at_once = 390;  // a query has at most 2000 columns
  static constexpr int first_column = 4;              // the first sequence, and the last
  static constexpr int columns_before = 6, least_column = 1, most_column = 2, mean_column = 3, odd_column = 4,
                       columns_each = 5;

  /// The longest that the steps asked for are made of; null: there are none.
  const sqlite::StepLength* recorded_steps() const {
    const RowFilter& filter = selection_.filter;
    if (steps_.times == RowFilter::Times::utc || filter.every > 1 || leaves_.size() > sqlite::most_step_fields)
      return nullptr;
    for (auto length = sqlite::step_lengths.rbegin(); length != sqlite::step_lengths.rend(); ++length) {
      const auto begins_one = [&](const std::optional<Time>& at) {
        return !at || to_nanoseconds(*at) % length->nanoseconds == 0;
      };
      if (steps_.step % length->nanoseconds != 0 || !begins_one(filter.from) || !begins_one(filter.until)) continue;
      if (sqlite::has_table(file_->database, sqlite::step_table(topic_.table, *length))) return &*length;
    }
    return nullptr;
  }

  std::string of_rows(std::size_t first) const {
    std::string sql = "SELECT t.run, " + step_sql() + ", t.origin, count(*), min(t.sequence), max(t.sequence)";
    for (std::size_t i = first; i < std::min(first + leaves_at_once, leaves_.size()); ++i) sql += columns(*leaves_[i]);
    return sql + " FROM " + sqlite::quoted(topic_.table) + " t WHERE " + row_conditions(selection_);
  }

  /// The same of recorded steps, and of those rows that are in none.
  std::string of_recorded(const sqlite::StepLength& length) {
    std::string sql = "SELECT t.run, " + step_sql() + ", t.origin, sum(t.events), min(t.first), max(t.last)";
    std::string
        recorded = "SELECT t.run, t.time, t.origin, t.events, t.first_sequence AS first, t.last_sequence AS last";
    std::string rows = "SELECT t.run, t.time, t.origin, 1, t.sequence, t.sequence";
    for (std::size_t i = 0; i < leaves_.size(); ++i) {
      const OfLeaf of(*leaves_[i]);
      const auto figure = [&](const char* name) { return "t." + sqlite::quoted(leaves_[i]->path + name); };
      const auto column = [n = std::to_string(i)](const char* name) { return "t." + (name + n); };
      const auto as = [n = std::to_string(i)](const char* name) {
        return std::string(" AS ") + name + n + (name == std::string_view("odd") ? "" : ", ");
      };
      recorded += ", " + figure(".count") + as("n") + of.in_order(figure(".min")) + as("low") +
                  of.in_order(figure(".max")) + as("high") + figure(".sum") + as("total") + "0" + as("odd");
      rows += ", " + of.number() + " IS NOT NULL" + as("n") + of.ordered() + as("low") + of.ordered() + as("high") +
              of.number() + as("total") + of.odd() + as("odd");
      // A sum that is none makes the mean none.
      sql += ", total(" + column("n") + "), min(" + column("low") + "), max(" + column("high") + "), iif(count(" +
             column("total") + ") = count(nullif(" + column("n") + ", 0)), total(" + column("total") + ") / sum(" +
             column("n") + "), NULL), " + (is_float(leaves_[i]->kind) ? "0" : "total(" + column("odd") + ")");
    }
    recorded += " FROM " + sqlite::quoted(sqlite::step_table(topic_.table, length)) + " t WHERE " +
                row_conditions(selection_);
    if (has_others(length)) {
      recorded += " UNION ALL " + rows + " FROM " + sqlite::quoted(topic_.table) + " t WHERE " +
                  row_conditions(selection_) +
                  " AND NOT EXISTS(SELECT 1 FROM rtdata_ledger l WHERE l.run = t.run AND l.topic = :topic AND l.origin "
                  "= t.origin AND l." +
                  std::string(length.from) + " BETWEEN 1 AND t.sequence)";
    }
    return sql + " FROM (" + recorded + ") t";
  }

  /// Whether there may be rows that are in no step. They are the first of an origin, or all of it.
  bool has_others(const sqlite::StepLength& length) const {
    const std::string from = "t." + std::string(length.from);
    auto statement = file_->prepare(
        "SELECT EXISTS(SELECT 1 FROM rtdata_ledger t JOIN rtdata_run r ON r.run = t.run WHERE t.topic = :topic AND "
        "ifnull(t.run = :run, 1) AND ifnull(t.origin = :origin, 1) AND (t.stored > t.pruned OR r.state = 'recording') "
        "AND NOT (" +
        from + " <> 0 AND t.first_sequence <> 0 AND t.pruned >= " + from + " - t.first_sequence))");
    const auto index = [&](const char* name) { return sqlite3_bind_parameter_index(statement.raw(), name); };
    const RowFilter& filter = selection_.filter;
    statement.bind(index(":topic"), std::string_view(topic_.topic));
    if (filter.run) statement.bind(index(":run"), *filter.run);
    if (filter.origin) statement.bind(index(":origin"), std::string_view(*filter.origin));
    statement.step();
    return statement.integer(0) != 0;
  }

  std::string step_sql() const {
    if (steps_.times == RowFilter::Times::utc) return "rtdata_step(:steps, t.run, t.time)";
    const std::string step = std::to_string(steps_.step);
    return "t.time / " + step + " - (t.time % " + step + " < 0)";
  }

  /// SQL of a field in a row.
  class OfLeaf {
   public:
    explicit OfLeaf(const Leaf& leaf) : leaf_(leaf), column_("t." + sqlite::quoted(leaf.path)) {}
    /// NULL when there is none.
    std::string number() const {
      if (leaf_.kind == Kind::u64) return signed_or(column_, " + 18446744073709551616.0", "");
      return is_float(leaf_.kind) && leaf_.optional != nullptr ? "nullif(" + column_ + ", 'NaN')" : column_;
    }
    /// What the least and the largest are found by.
    std::string ordered() const { return leaf_.kind == Kind::u64 ? in_order(column_) : number(); }
    std::string in_order(const std::string& of) const {
      if (leaf_.kind != Kind::u64) return of;
      return signed_or(of, " + 9223372036854775807 + 1", " - 9223372036854775807 - 1");  // `turned`
    }
    /// Whether it is no number, where the largest does not tell.
    std::string odd() const {
      return is_float(leaf_.kind) ? "0" : "typeof(" + column_ + ") NOT IN ('integer', 'null')";
    }

   private:
    static std::string signed_or(const std::string& of, const char* negative, const char* other) {
      return "iif(" + of + " < 0, " + of + negative + ", " + of + other + ")";
    }
    const Leaf& leaf_;
    const std::string column_;
  };

  /// How many values of a field there are, the least, the largest, the mean, and whether one is none.
  static std::string columns(const Leaf& leaf) {
    const OfLeaf of(leaf);
    return ", count(" + of.number() + "), min(" + of.ordered() + "), max(" + of.ordered() + "), avg(" + of.number() +
           "), " + (is_float(leaf.kind) ? "0" : "total(" + of.odd() + ")");
  }

  void bind(sqlite::Statement& statement) {
    bind_conditions(statement, selection_);
    const int steps = sqlite3_bind_parameter_index(statement.raw(), ":steps");
    if (steps != 0) sqlite3_bind_pointer(statement.raw(), steps, &steps_, Steps::pointer_type, nullptr);
    const int topic = sqlite3_bind_parameter_index(statement.raw(), ":topic");
    if (topic != 0) statement.bind(topic, std::string_view(topic_.topic));
  }

  std::pair<const sqlite::Statement&, int> place_of(std::size_t leaf) const {
    return {statements_[leaf / leaves_at_once],
            columns_before + static_cast<int>(leaf % leaves_at_once) * columns_each};
  }

  /// The rows of the step at hand, once more.
  sqlite::Statement of_step(const std::string& what, const std::string& condition) {
    const sqlite::Statement& first = statements_.front();
    auto statement = file_->prepare("SELECT " + what + " FROM " + sqlite::quoted(topic_.table) + " t WHERE " +
                                    row_conditions(selection_) + " AND t.run = :of_run AND " + step_sql() +
                                    " = :of_step AND t.origin = :of_origin AND " + condition);
    const auto index = [&](const char* name) { return sqlite3_bind_parameter_index(statement.raw(), name); };
    bind(statement);
    statement.bind(index(":of_run"), first.integer(0)).bind(index(":of_step"), first.integer(1));
    statement.bind(index(":of_origin"), first.text(2));
    return statement;
  }

  /// Near the largest numbers a sum is none any more, where the mean is.
  double mean(const Leaf& leaf, const sqlite::Statement& of, int column) {
    const double found = of.is_null(column + mean_column) ? std::numeric_limits<double>::quiet_NaN()
                                                          : of.real(column + mean_column);
    const bool are_finite = std::isfinite(of.real(column + least_column)) &&
                            std::isfinite(of.real(column + most_column));
    if (std::isfinite(found) || !are_finite) return found;
    // Of values so small that the sum of as many as a step can have is a number.
    auto scaled = of_step("avg(nullif(t." + sqlite::quoted(leaf.path) + ", 'NaN') / 18446744073709551616.0)", "1");
    scaled.step();
    return scaled.real(0) * 0x1p64;
  }

  [[noreturn]] void tell_odd(const Leaf& leaf) {
    const std::string allowed = is_float(leaf.kind) ? "('integer', 'real', 'null')" : "('integer', 'null')";
    const std::string column = "t." + sqlite::quoted(leaf.path);
    auto row = of_step("t.sequence", "typeof(" + column + ") NOT IN " + allowed + " AND " + column + " IS NOT 'NaN'");
    row.step();
    throw SetupError(at_row(*file_, topic_, run, statements_.front().text(2),
                            static_cast<std::uint64_t>(row.integer(0)),
                            {Errc::damaged, "cannot read a row", "field " + leaf.path,
                             "it holds a value that is not a valid " + std::string(name_of(leaf.kind)), ""}));
  }

  const std::shared_ptr<RecordingFile> file_;
  const RecordedTopic topic_;
  RecordedTopic out_;
  const Selection selection_;
  Steps steps_;
  std::vector<const Leaf*> leaves_;                 // that are numbers
  std::vector<sqlite::Statement> statements_;       // each of some of them
  std::map<std::string, std::uint64_t> sequences_;  // of the last step, by origin
};

}  // namespace

void provide_steps(const sqlite::Database& database) {
  if (sqlite3_create_function_v2(database.raw(), "rtdata_step", 3, SQLITE_UTF8 | SQLITE_DIRECTONLY, nullptr, &step_of,
                                 nullptr, nullptr, nullptr) != SQLITE_OK)
    throw SetupError(sqlite::error_of(database.raw(), "cannot read the recording"));
}

std::unique_ptr<RowCursor> make_step_cursor(const Recording& recording, RecordedTopic topic, const Selection& selection,
                                            Duration step) {
  return std::make_unique<StepCursor>(recording, std::move(topic), selection, step);
}

}  // namespace rtdata::detail
