// Reduces a topic's rows to steps: count, minimum, maximum and mean of each number. Recorded steps of a second or a
// minute are read instead of the rows where they add up to the requested steps.
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

/// The record that a field becomes; null: the field has no number.
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

/// The description of the steps for SQL: a query passes a pointer to it to `step_of`.
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

/// The longest recorded steps of which the steps asked for are made; null: there are none.
const sqlite::StepLength* recorded_steps(const RecordingFile& file, const RecordedTopic& topic, const RowFilter& filter,
                                         Duration step) {
  const auto& leaves = topic.description->leaves();
  const auto numbers = std::count_if(leaves.begin(), leaves.end(),
                                     [](const Leaf& leaf) { return is_number(leaf.kind); });
  if (filter.times == RowFilter::Times::utc || filter.every > 1 ||
      static_cast<std::size_t>(numbers) > sqlite::most_step_fields)
    return nullptr;
  for (auto length = sqlite::step_lengths.rbegin(); length != sqlite::step_lengths.rend(); ++length) {
    const auto begins_one = [&](const std::optional<Time>& at) {
      return !at || to_nanoseconds(*at) % length->nanoseconds == 0;
    };
    if (step.count() % length->nanoseconds != 0 || !begins_one(filter.from) || !begins_one(filter.until)) continue;
    if (sqlite::has_table(file.database, sqlite::step_table(topic.table, *length))) return &*length;
  }
  return nullptr;
}

/// A query of the accounts of a topic, as the filter has them.
sqlite::Statement of_ledger(const RecordingFile& file, const RecordedTopic& topic, const RowFilter& filter,
                            const std::string& sql) {
  auto statement = file.prepare(sql);
  const auto index = [&](const char* name) { return sqlite3_bind_parameter_index(statement.raw(), name); };
  statement.bind(index(":topic"), std::string_view(topic.topic));
  if (filter.run) statement.bind(index(":run"), *filter.run);
  if (filter.origin && index(":origin") != 0) statement.bind(index(":origin"), std::string_view(*filter.origin));
  return statement;
}

/// True if there may be rows in no recorded step. They are the first rows of an origin, or all of them.
bool has_others(const RecordingFile& file, const RecordedTopic& topic, const RowFilter& filter,
                const sqlite::StepLength& length) {
  const std::string from = "t." + std::string(length.from);
  auto statement = of_ledger(
      file, topic, filter,
      "SELECT EXISTS(SELECT 1 FROM rtdata_ledger t JOIN rtdata_run r ON r.run = t.run WHERE t.topic = :topic AND "
      "ifnull(t.run = :run, 1) AND ifnull(t.origin = :origin, 1) AND (t.stored > t.pruned OR r.state = 'recording') "
      "AND NOT (" +
          from + " <> 0 AND t.first_sequence <> 0 AND t.pruned >= " + from + " - t.first_sequence))");
  statement.step();
  return statement.integer(0) != 0;
}

class StepCursor final : public RowCursor {
 public:
  /// The tables that the steps are read from.
  struct Source {
    const sqlite::StepLength* recorded = nullptr;  ///< null: rows alone
    bool has_others = false;                       ///< rows beside recorded steps
  };
  StepCursor(const Recording& recording, RecordedTopic topic, const Selection& selection, Duration step,
             std::span<const std::string> fields, Source source)
      : file_(recording.file()), topic_(std::move(topic)), out_(topic_), selection_(selection) {
    steps_ = {step.count(), selection.filter.times, {}};
    if (steps_.times == RowFilter::Times::utc)
      for (const RunInfo& one : recording.runs().or_throw())
        steps_.lines.emplace(one.run, utc_line_of(*file_, one.run));
    out_.description = description_of_steps(*topic_.description);
    std::size_t column = 1;  // behind the number of events
    for (const Leaf& leaf : topic_.description->leaves()) {
      if (!is_number(leaf.kind)) continue;
      const bool is_wanted = fields.empty() || std::find(fields.begin(), fields.end(), leaf.path) != fields.end();
      if (is_wanted) numbers_.push_back({&leaf, column});
      column += 4;
    }
    for (std::size_t first = 0; first == 0 || first < numbers_.size(); first += numbers_at_once) {
      statements_.push_back(file_->prepare(source.recorded != nullptr ? of_recorded(source) : of_rows(first)));
      bind(statements_.back());
    }
    go_on();
  }

  bool advance() override {
    if (!has_row_) return false;
    const sqlite::Statement& first = statements_.front();
    if (std::exchange(run, first.integer(0)) != first.integer(0)) sequences_.clear();
    step_ = first.integer(1);
    origin_ = first.text(2);
    if (__builtin_mul_overflow(step_, steps_.step, &time)) time = std::numeric_limits<std::int64_t>::min();
    events_ = 0;
    first_ = first.integer(first_column);
    last_ = first.integer(first_column + 1);
    for (Number& number : numbers_) number.count = 0;
    do {
      events_ += first.integer(events_column);
      first_ = std::min(first_, first.integer(first_column));
      last_ = std::max(last_, first.integer(first_column + 1));
      for (std::size_t i = 0; i < numbers_.size(); ++i) add(i);
      go_on();
    } while (has_row_ && first.integer(0) == run && first.integer(1) == step_ && first.text(2) == origin_);
    return true;
  }

  void give(RecordedRow& row) override {
    std::byte* const payload = set_event(row, origin_, ++sequences_[origin_], out_);
    set_sequences(row, static_cast<std::uint64_t>(first_), static_cast<std::uint64_t>(last_));
    std::fill(payload, payload + out_.description->size(), std::byte{0});
    const std::vector<Leaf>& leaves = out_.description->leaves();
    write(leaves.front(), payload, Value{events_}).or_throw();
    for (const Number& number : numbers_) {
      const Leaf* to = &leaves[number.place];
      const auto put = [&](const Value& value) { write(*to++, payload, value).or_throw(); };
      put(number.count);
      if (number.count == 0) continue;
      if (is_float(number.leaf->kind)) {
        put(number.least);
        put(number.most);
        put(std::clamp(mean_of(number), number.least, number.most));  // the sum was rounded
      } else {
        const bool is_unsigned = number.leaf->kind == Kind::u64;
        for (const std::int64_t value : {number.low, number.high})
          put(is_unsigned ? Value{static_cast<std::uint64_t>(turned(value))} : Value{value});
        put(mean_of(number));
      }
    }
  }

 private:
  static constexpr std::size_t numbers_at_once = 390;        // a query has at most 2000 columns
  static constexpr int events_column = 3, first_column = 4;  // the first sequence, and the last
  static constexpr int columns_before = 6, least_column = 1, most_column = 2, sum_column = 3, odd_column = 4,
                       columns_each = 5;

  /// A requested number in the current step.
  struct Number {
    const Leaf* leaf;
    std::size_t place;  ///< of its count, among the leaves of steps
    std::int64_t count = 0;
    double least = 0, most = 0;      ///< of a float
    std::int64_t low = 0, high = 0;  ///< of any other, in order
    double sum = 0;
  };

  void go_on() {
    for (sqlite::Statement& statement : statements_) has_row_ = statement.step();  // all give the same steps
  }

  /// Of a recorded step, or of rows.
  void add(std::size_t i) {
    Number& number = numbers_[i];
    const sqlite::Statement& row = statements_[i / numbers_at_once];
    const int column = columns_before + static_cast<int>(i % numbers_at_once) * columns_each;
    const int type = sqlite3_column_type(row.raw(), column + most_column);  // of texts and blobs, too
    if (row.integer(column + odd_column) != 0 || type == SQLITE_TEXT || type == SQLITE_BLOB) tell_odd(*number.leaf);
    const std::int64_t count = row.integer(column);
    if (count == 0) return;
    const bool is_first = number.count == 0;
    if (is_float(number.leaf->kind)) {
      const double least = row.real(column + least_column), most = row.real(column + most_column);
      number.least = is_first ? least : std::min(number.least, least);
      number.most = is_first ? most : std::max(number.most, most);
    } else {
      const std::int64_t low = row.integer(column + least_column), high = row.integer(column + most_column);
      number.low = is_first ? low : std::min(number.low, low);
      number.high = is_first ? high : std::max(number.high, high);
    }
    // SQL has no NaN: a sum of NULL gives a mean of NULL.
    const double sum = row.is_null(column + sum_column) ? std::numeric_limits<double>::quiet_NaN()
                                                        : row.real(column + sum_column);
    number.sum = is_first ? sum : number.sum + sum;
    number.count += count;
  }

  std::string of_rows(std::size_t first) const {
    std::string sql = "SELECT t.run, " + step_sql() + ", t.origin, count(*), min(t.sequence), max(t.sequence)";
    for (std::size_t i = first; i < std::min(first + numbers_at_once, numbers_.size()); ++i)
      sql += columns(*numbers_[i].leaf);
    return sql + " FROM " + sqlite::quoted(topic_.table) + " t WHERE " + row_conditions(selection_) +
           " GROUP BY 1, 2, 3 ORDER BY 1, 2, 3";
  }

  /// Recorded steps, and each of the rows that are in none.
  std::string of_recorded(const Source& source) const {
    const std::string begin = "SELECT t.run, " + step_sql() + ", t.origin, ";
    std::string recorded = begin + "t.events, t.first_sequence, t.last_sequence";
    std::string rows = begin + "1, t.sequence, t.sequence";
    for (const Number& number : numbers_) {
      const OfLeaf of(*number.leaf);
      const auto figure = [&](const char* name) { return "t." + sqlite::quoted(number.leaf->path + name); };
      recorded += ", " + figure(".count") + ", " + of.in_order(figure(".min")) + ", " + of.in_order(figure(".max")) +
                  ", " + figure(".sum") + ", 0";
      rows += ", " + of.number() + " IS NOT NULL, " + of.ordered() + ", " + of.ordered() + ", " + of.number() + ", " +
              of.odd();
    }
    recorded += " FROM " + sqlite::quoted(sqlite::step_table(topic_.table, *source.recorded)) + " t WHERE " +
                row_conditions(selection_);
    // Rows of one origin are stored in time order.
    if (!source.has_others)
      return recorded + (selection_.filter.origin ? " ORDER BY t.run, t.time" : " ORDER BY 1, 2, 3");
    return recorded + " UNION ALL " + rows + " FROM " + sqlite::quoted(topic_.table) + " t WHERE " +
           row_conditions(selection_) +
           " AND NOT EXISTS(SELECT 1 FROM rtdata_ledger l WHERE l.run = t.run AND l.topic = :topic AND l.origin "
           "= t.origin AND l." +
           std::string(source.recorded->from) + " BETWEEN 1 AND t.sequence) ORDER BY 1, 2, 3";
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
    /// The SQL expression by which the least and the largest are found.
    std::string ordered() const { return leaf_.kind == Kind::u64 ? in_order(column_) : number(); }
    std::string in_order(const std::string& of) const {
      if (leaf_.kind != Kind::u64) return of;
      return signed_or(of, " + 9223372036854775807 + 1", " - 9223372036854775807 - 1");  // `turned`
    }
    /// SQL: true if it is not a number, where the largest value does not show that.
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

  /// SQL for a field: number of values, least, largest, sum, and if one is not a number.
  static std::string columns(const Leaf& leaf) {
    const OfLeaf of(leaf);
    return ", count(" + of.number() + "), min(" + of.ordered() + "), max(" + of.ordered() + "), total(" + of.number() +
           "), " + (is_float(leaf.kind) ? "0" : "total(" + of.odd() + ")");
  }

  void bind(sqlite::Statement& statement) {
    bind_conditions(statement, selection_);
    const int steps = sqlite3_bind_parameter_index(statement.raw(), ":steps");
    if (steps != 0) sqlite3_bind_pointer(statement.raw(), steps, &steps_, Steps::pointer_type, nullptr);
    const int topic = sqlite3_bind_parameter_index(statement.raw(), ":topic");
    if (topic != 0) statement.bind(topic, std::string_view(topic_.topic));
  }

  /// Reads the rows of the current step again.
  sqlite::Statement of_step(const std::string& what, const std::string& condition) {
    auto statement = file_->prepare("SELECT " + what + " FROM " + sqlite::quoted(topic_.table) + " t WHERE " +
                                    row_conditions(selection_) + " AND t.run = :of_run AND " + step_sql() +
                                    " = :of_step AND t.origin = :of_origin AND " + condition);
    const auto index = [&](const char* name) { return sqlite3_bind_parameter_index(statement.raw(), name); };
    bind(statement);
    statement.bind(index(":of_run"), run).bind(index(":of_step"), step_);
    statement.bind(index(":of_origin"), std::string_view(origin_));
    return statement;
  }

  /// Near the largest numbers a sum overflows, but the mean does not.
  double mean_of(const Number& of) {
    const double found = of.sum / static_cast<double>(of.count);
    const bool are_finite = std::isfinite(of.least) && std::isfinite(of.most);
    if (std::isfinite(found) || !are_finite) return found;
    // The values are scaled down, so that the sum of as many as a step can have does not overflow.
    auto scaled = of_step("avg(nullif(t." + sqlite::quoted(of.leaf->path) + ", 'NaN') / 18446744073709551616.0)", "1");
    scaled.step();
    return scaled.real(0) * 0x1p64;
  }

  [[noreturn]] void tell_odd(const Leaf& leaf) {
    const std::string allowed = is_float(leaf.kind) ? "('integer', 'real', 'null')" : "('integer', 'null')";
    const std::string column = "t." + sqlite::quoted(leaf.path);
    auto row = of_step("t.sequence", "typeof(" + column + ") NOT IN " + allowed + " AND " + column + " IS NOT 'NaN'");
    row.step();
    throw SetupError(at_row(*file_, topic_, run, origin_, static_cast<std::uint64_t>(row.integer(0)),
                            {Errc::damaged, "cannot read a row", "field " + leaf.path,
                             "it holds a value that is not a valid " + std::string(name_of(leaf.kind)), ""}));
  }

  const std::shared_ptr<RecordingFile> file_;
  const RecordedTopic topic_;
  RecordedTopic out_;
  const Selection selection_;
  Steps steps_;
  std::vector<Number> numbers_;
  std::vector<sqlite::Statement> statements_;  // each of some of them
  bool has_row_ = false;                       // they are at one that is not added yet
  std::int64_t step_ = 0, events_ = 0, first_ = 0, last_ = 0;
  std::string origin_;
  std::map<std::string, std::uint64_t> sequences_;  // of the last step, by origin
};

}  // namespace

void provide_steps(const sqlite::Database& database) {
  if (sqlite3_create_function_v2(database.raw(), "rtdata_step", 3, SQLITE_UTF8 | SQLITE_DIRECTONLY, nullptr, &step_of,
                                 nullptr, nullptr, nullptr) != SQLITE_OK)
    throw SetupError(sqlite::error_of(database.raw(), "cannot read the recording"));
}

void add_step_cursors(RowsMerge& to, const Recording& recording, RecordedTopic topic, const Selection& selection,
                      Duration step, std::span<const std::string> fields) {
  constexpr std::size_t most_apart = 16;  // each has a query of its own
  const auto add = [&](const Selection& of, const StepCursor::Source& source) {
    to.add(std::make_unique<StepCursor>(recording, topic, of, step, fields, source));
  };
  const RowFilter& filter = selection.filter;
  const RecordingFile& file = *recording.file();
  StepCursor::Source source{recorded_steps(file, topic, filter, step)};
  if (source.recorded == nullptr) return add(selection, source);
  source.has_others = has_others(file, topic, filter, *source.recorded);
  std::vector<std::string> origins;  // each of which lies in order, where SQLite would have to sort all of them
  if (!source.has_others && !filter.origin)
    origins = of_ledger(file, topic, filter,
                        "SELECT DISTINCT origin FROM rtdata_ledger WHERE topic = :topic AND ifnull(run = :run, 1) "
                        "ORDER BY origin")
                  .texts();
  if (origins.empty() || origins.size() > most_apart) return add(selection, source);
  for (std::string& origin : origins) {
    Selection of = selection;
    of.filter.origin = std::move(origin);
    add(of, source);
  }
}

}  // namespace rtdata::detail
