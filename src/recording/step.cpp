#include "recording/step.hpp"

#include <algorithm>

#include "recording/schema.hpp"

namespace rtdata::sqlite {

std::string step_table(std::string_view table, const StepLength& length) {
  return std::string(table).append(length.ending);
}

std::vector<std::string> tables_of_topic(std::string_view table) {
  std::vector<std::string> all{std::string(table)};
  for (const StepLength& length : step_lengths) all.push_back(step_table(table, length));
  return all;
}

bool has_table(const Database& database, const std::string& name) {
  // Found in memory, where a query would go through the whole schema.
  return sqlite3_table_column_metadata(database.raw(), "main", name.c_str(), nullptr, nullptr, nullptr, nullptr,
                                       nullptr, nullptr) == SQLITE_OK;
}

bool is_number(Kind kind) noexcept {
  return kind != Kind::text && kind != Kind::character && kind != Kind::enumeration && kind != Kind::record;
}

std::vector<StepField> step_fields(const std::vector<const Leaf*>& leaves) {
  std::vector<StepField> fields;
  for (const Leaf* leaf : leaves) {
    if (!is_number(leaf->kind)) continue;
    StepField::Type type = leaf->kind == Kind::u64 ? StepField::Type::natural : StepField::Type::integer;
    if (leaf->kind == Kind::f64 || leaf->kind == Kind::f32) type = StepField::Type::real;
    fields.push_back({leaf, type, leaf->offset});
  }
  return fields;
}

std::vector<std::string> figure_columns(const StepField& field) {
  std::vector<std::string> columns;
  for (const std::string_view figure : figures) {
    const bool is_real = figure == ".sum" || (field.type == StepField::Type::real && figure != ".count");
    columns.push_back(quoted(field.leaf->path + std::string(figure)) + (is_real ? " REAL" : " INTEGER"));
  }
  return columns;
}

std::string make_step_table(const std::string& name, const std::vector<StepField>& fields) {
  std::string sql = "CREATE TABLE " + quoted(name) +
                    "(run INTEGER NOT NULL, time INTEGER NOT NULL, origin TEXT NOT NULL, events INTEGER NOT NULL, "
                    "first_sequence INTEGER NOT NULL, last_sequence INTEGER NOT NULL, " +
                    quoted(checksum_column) + " INTEGER NOT NULL";
  for (const StepField& field : fields)
    for (const std::string& column : figure_columns(field)) sql += ", " + column;
  return sql + ", PRIMARY KEY(run, origin, time))";
}

void Step::add(const Step& later, const std::vector<StepField>& fields) noexcept {
  if (later.is_empty()) return;
  if (is_empty()) first = later.first;
  last = later.last;
  events += later.events;
  for (std::size_t i = 0; i < numbers_.size(); ++i) {
    Number& number = numbers_[i];
    const Number& other = later.numbers_[i];
    if (other.count == 0) continue;
    const bool is_first = number.count == 0;
    if (fields[i].type == StepField::Type::real) {
      if (is_first || other.least.real < number.least.real) number.least = other.least;
      if (is_first || other.most.real > number.most.real) number.most = other.most;
    } else {
      if (is_first || other.least.integer < number.least.integer) number.least = other.least;
      if (is_first || other.most.integer > number.most.integer) number.most = other.most;
    }
    number.last = other.last;
    number.sum += other.sum;
    number.count += other.count;
  }
}

}  // namespace rtdata::sqlite
