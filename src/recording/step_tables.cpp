#include "recording/step_tables.hpp"

#include <algorithm>
#include <cstring>
#include <type_traits>
#include <variant>

#include "data/load.hpp"
#include "recording/schema.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata::sqlite {
namespace {

using detail::for_number;
using detail::load;

void add_value(Step& step, std::size_t field, const Leaf& leaf, const std::byte* payload) {
  const std::byte* const at = leaf.optional == nullptr ? payload + leaf.offset : find_value(leaf, payload);
  if (at == nullptr) return;
  if (leaf.kind == Kind::boolean) return step.add(field, std::int64_t{load<bool>(at)});
  for_number(leaf.kind, [&](auto zero) {
    using T = decltype(zero);
    using Wide = std::conditional_t<std::is_same_v<T, std::uint64_t>, T, std::int64_t>;
    step.add(field, static_cast<std::conditional_t<std::is_floating_point_v<T>, double, Wide>>(load<T>(at)));
  });
}

/// Binds what a step gives, behind the columns up to the checksum.
struct Binder {
  sqlite3_stmt* statement;
  int next;
  void integer(std::int64_t value) { sqlite3_bind_int64(statement, place(), value); }
  void real(double value) { sqlite3_bind_double(statement, place(), value); }  // NaN becomes NULL
  void null() { sqlite3_bind_null(statement, place()); }
  int place() noexcept {
    if (next == step_checksum_column + 1) ++next;
    return next++;
  }
};

}  // namespace

OpenSteps::Change OpenSteps::change(std::uint32_t slot, std::size_t fields) {
  if (slot >= origins_.size()) origins_.resize(slot + 1);
  auto& kept = origins_[slot];
  if (kept == nullptr) kept = std::make_unique<Kept>(Kept{Origin(fields), Origin(fields)});
  const bool is_first = !kept->is_changed;
  if (is_first) {
    changed_.push_back(kept.get());
    kept->is_changed = true;
  }
  return {kept->now, is_first};
}

void OpenSteps::committed() {
  for (Kept* kept : changed_) {
    kept->committed = kept->now;
    kept->is_changed = false;
  }
  changed_.clear();
  tables_made_ = 0;
}

void OpenSteps::rolled_back() {
  for (Kept* kept : changed_) {
    kept->now = kept->committed;
    kept->is_changed = false;
  }
  changed_.clear();
  tables_made_ = 0;
}

StepTables::StepTables(Database& database, AccountSums& sums, OpenSteps& open, std::string table, std::int64_t run,
                       const std::vector<const Leaf*>& leaves)
    : database_(database),
      sums_(sums),
      open_(open),
      table_(std::move(table)),
      run_(run),
      fields_(step_fields(leaves)),
      whole_minute_(fields_.size()) {
  for (const StepField& field : fields_)
    are_doubles_ = are_doubles_ && field.leaf->kind == Kind::f64 && field.leaf->optional == nullptr;
}

bool StepTables::has_steps(const std::vector<const Leaf*>& leaves) {
  return step_fields(leaves).size() <= most_step_fields;
}

void StepTables::add_columns(Database& database, const std::string& table, const std::vector<const Leaf*>& leaves) {
  if (!has_steps(leaves)) return;
  const auto fields = step_fields(leaves);
  for (const StepLength& length : step_lengths) {
    const std::string name = step_table(table, length);
    if (!has_table(database, name)) continue;
    auto columns = columns_of(database, name);
    for (const StepField& field : fields) {
      if (std::find(columns.begin(), columns.end(), field.leaf->path + std::string(figures[0])) != columns.end())
        continue;
      for (const std::string& column : figure_columns(field))
        database.execute("ALTER TABLE " + quoted(name) + " ADD COLUMN " + column);
    }
  }
}

void StepTables::add(const Record& record) {
  if (record.info != last_slot_) {
    const auto [origin, is_first] = open_.change(record.slot, fields_.size());
    last_origin_ = &origin;
    last_slot_ = record.info;
    if (is_first) changed_.push_back({last_origin_, last_slot_});
  }
  const Changed of{last_origin_, last_slot_};
  OriginSteps& steps = of.origin->steps;
  steps.go_to(to_nanoseconds(record.header.time), fields_,
              [&](std::size_t length, Step& step) { end(of, length, step); });
  steps.second.add_event(record.header.sequence);
  const std::byte* const payload = record.payload.data();
  if (are_doubles_) {
    for (std::size_t i = 0; i < fields_.size(); ++i) steps.second.add(i, load<double>(payload + fields_[i].offset));
  } else {
    for (std::size_t i = 0; i < fields_.size(); ++i) add_value(steps.second, i, *fields_[i].leaf, payload);
  }
}

void StepTables::flush() {
  for (const Changed& of : changed_) {
    OriginSteps& steps = of.origin->steps;
    keep(of, seconds, steps.second);
    whole_minute_ = steps.minute;
    whole_minute_.add(steps.second, fields_);
    keep(of, minutes, whole_minute_);
  }
  changed_.clear();
  last_slot_ = nullptr;
}

void StepTables::end(const Changed& of, std::size_t length, Step& step) {
  if (of.origin->from[length] != 0 || begin(of, length, step)) {
    write(*of.slot, length, step);
  } else {
    std::swap(of.origin->before[length], step);
  }
}

void StepTables::keep(const Changed& of, std::size_t length, const Step& step) {
  if (of.origin->from[length] != 0 || begin(of, length, step)) write(*of.slot, length, step);
}

bool StepTables::begin(const Changed& of, std::size_t length, const Step& step) {
  if (step.events < step_lengths[length].first_events || !prepare(length)) return false;
  const Step& before = of.origin->before[length];
  const std::uint64_t from = before.is_empty() ? step.first : before.first;
  const std::string where = " WHERE run = ? AND topic = ? AND origin = ?";
  auto ledger_before = database_.prepare("SELECT * FROM rtdata_ledger" + where);
  ledger_before.bind(1, run_).bind(2, of.slot->topic).bind(3, of.slot->origin);
  auto ledger = database_.prepare("UPDATE rtdata_ledger SET " + std::string(step_lengths[length].from) + " = " +
                                  std::to_string(from) + where + " RETURNING *");
  ledger.bind(1, run_).bind(2, of.slot->topic).bind(3, of.slot->origin);
  sums_.replace(ledger_before, ledger);
  if (!before.is_empty()) write(*of.slot, length, before);
  of.origin->from[length] = from;
  return true;
}

void StepTables::write(const SlotInfo& slot, std::size_t length, const Step& step) {
  if (!prepare(length)) return;  // its table was made
  Statement& insert = insert_[length];
  insert.bind(1, run_).bind(2, step.time).bind(3, std::string_view(slot.origin));
  insert.bind(step_checksum_column + 1, static_cast<std::int64_t>(step.hash(slot.origin, fields_, hash_)));
  Binder binder{insert.raw(), 4};
  step.give(fields_, binder);
  insert.run();
}

bool StepTables::prepare(std::size_t length) {
  if (insert_[length]) return true;
  if (is_refused_[length]) return false;
  const std::string name = step_table(table_, step_lengths[length]);
  try {
    if (!has_table(database_, name)) {
      if (!open_.may_make_table()) return false;
      database_.execute(make_step_table(name, fields_));
    }
    std::string into = "INSERT OR REPLACE INTO " + quoted(name) + "(";
    std::string values;
    const auto add_column = [&](const std::string& column) {
      into += (values.empty() ? "" : ", ") + quoted(column);
      values += values.empty() ? "?" : ",?";
    };
    for (const std::string_view column : step_columns) add_column(std::string(column));
    for (const StepField& field : fields_)
      for (const std::string_view figure : figures) add_column(field.leaf->path + std::string(figure));
    insert_[length] = database_.prepare(into + ") VALUES(" + values + ")");
  } catch (const SetupError& error) {
    if (sqlite3_errcode(database_.raw()) != SQLITE_ERROR) throw;
    is_refused_[length] = true;
    Error warning = error.error();
    warning.what = "cannot record steps of " + std::string(step_lengths[length].text);
    warning.where = "table " + name;
    warning.advice = "pictures of the topic are made of its rows, which takes longer; record into another file";
    open_.warn(std::move(warning));
    return false;
  }
  return true;
}

}  // namespace rtdata::sqlite
