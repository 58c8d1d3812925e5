#include "sinks/sqlite/csv_rows.hpp"

#include <cstring>
#include <limits>

#include "data/copy.hpp"
#include "data/number_text.hpp"
#include "data/time_text.hpp"
#include "data/utf8.hpp"

namespace rtdata::detail {
namespace {

std::string_view value_text(sqlite3_value* value) {
  const auto* bytes = static_cast<const char*>(sqlite3_value_blob(value));
  return {bytes, bytes == nullptr ? 0 : static_cast<std::size_t>(sqlite3_value_bytes(value))};
}

/// As most texts are: they stand for themselves, without quotes and escapes.
bool is_plain(std::string_view text) noexcept {
  if (text.empty() || text.front() == ' ' || text.back() == ' ') return false;
  for (const char c : text) {
    if (c < ' ' || c == '"' || c == ',' || c == '\\' || c == 0x7f) return false;  // and above, where char is signed
    if (static_cast<unsigned char>(c) >= 0x80) return false;
  }
  return true;
}

char* put_quoted(char* to, std::string_view text) {
  *to++ = '"';
  for (const char c : text) {
    if (c == '"') *to++ = '"';
    *to++ = c;
  }
  *to++ = '"';
  return to;
}

template <class T>
bool fits(std::int64_t number) {
  return number >= std::numeric_limits<T>::min() && number <= std::numeric_limits<T>::max();
}

bool fits(Kind kind, std::int64_t number) {
  switch (kind) {
    case Kind::i8:
      return fits<std::int8_t>(number);
    case Kind::i16:
      return fits<std::int16_t>(number);
    case Kind::i32:
      return fits<std::int32_t>(number);
    case Kind::u8:
      return fits<std::uint8_t>(number);
    case Kind::u16:
      return fits<std::uint16_t>(number);
    case Kind::u32:
      return fits<std::uint32_t>(number);
    default:
      return kind == Kind::i64;
  }
}

}  // namespace

CsvRows::CsvRows(const Recording& recording, RecordedTopic topic, const ExportConfig& config, Runs runs)
    : recording_(&recording),
      topic_(std::move(topic)),
      filter_(config.filter),
      runs_(runs),
      is_utc_(config.time == ExportTime::utc),
      is_iso8601_(config.time_text == ExportConfig::TimeText::iso8601),
      codec_(make_csv_codec({is_iso8601_ ? CsvConfig::TimeFormat::iso8601 : CsvConfig::TimeFormat::nanoseconds})),
      longest_(5 * longest_number) {
  for (const Leaf& leaf : topic_.description->leaves()) {
    columns_.push_back({leaf.kind, leaf.optional != nullptr, &leaf});
    longest_ += longest_number + 1;
  }
  payload_.resize(topic_.description->size());
}

CsvRows CsvRows::make(const Recording& recording, RecordedTopic topic, const ExportConfig& config, Runs runs) {
  CsvRows rows(recording, std::move(topic), config, runs);
  auto selection = Selection::make(recording, rows.filter_);
  rows.statement_ = rows_in_order(*recording.file(), rows.topic_, selection, RowReader(rows.topic_).columns());
  return rows;
}

void CsvRows::begin_run(std::int64_t run) {
  run_ = run;
  if (!is_utc_) return;
  line_ = utc_line_of(*recording_->file(), run);
}

void CsvRows::append_by_codec(std::string& out, Time time) {
  const std::string origin(statement_.text(origin_column));
  const auto sequence = static_cast<std::uint64_t>(statement_.integer(sequence_column));
  try {
    RowReader(topic_).read(statement_.raw(), fixed_columns, payload_.data());
  } catch (const SetupError& error) {
    throw SetupError(at_row(*recording_->file(), topic_, run_, origin, sequence, error.error()));
  }
  bytes_.clear();
  const EventHeader header{time, sequence, origin};
  codec_->encode(EventView(topic_.topic, header, *topic_.description, payload_), bytes_).or_throw();
  out.append(reinterpret_cast<const char*>(bytes_.data()), bytes_.size());
  if (runs_ == Runs::named) out.replace(out.size() - 1, 1, "," + std::to_string(run_) + "\n");
}

/// Writes the current row to `to`, which points into `out`; returns the end, or null for a row that is unusual. `out`
/// has room for `longest_` bytes there, and is enlarged for texts.
char* CsvRows::put_row(char* to, Time time, std::string& out) {
  sqlite3_stmt* const row = statement_.raw();
  const auto make_room = [&](std::size_t more) {
    const auto used = static_cast<std::size_t>(to - out.data());
    if (out.size() - used >= more + longest_) return;
    out.resize(2 * out.size() + more + longest_);
    to = out.data() + used;
  };
  to = is_iso8601_ ? put_iso8601(to, time) : put_number(to, to_nanoseconds(time));
  *to++ = ',';
  const std::string_view origin = value_text(sqlite3_column_value(row, origin_column));
  if (!is_plain(origin)) return nullptr;
  make_room(origin.size());
  to = copy_short(to, origin.data(), origin.size());
  *to++ = ',';
  to = put_number(to, static_cast<std::uint64_t>(sqlite3_column_int64(row, sequence_column)));
  int index = fixed_columns - 1;
  for (const Column& column : columns_) {
    *to++ = ',';
    sqlite3_value* const value = sqlite3_column_value(row, ++index);
    const int type = sqlite3_value_type(value);
    if (type == SQLITE_NULL) {
      if (column.is_optional) continue;
      if (column.kind != Kind::f64 && column.kind != Kind::f32) return nullptr;
      to = copy_short(to, "nan", 3);
      continue;
    }
    switch (column.kind) {
      case Kind::f64:
        if (type != SQLITE_FLOAT && type != SQLITE_INTEGER) return nullptr;
        to = put_number(to, sqlite3_value_double(value));
        break;
      case Kind::f32:
        if (type != SQLITE_FLOAT && type != SQLITE_INTEGER) return nullptr;
        to = put_number(to, static_cast<float>(sqlite3_value_double(value)));
        break;
      case Kind::u64:
        if (type != SQLITE_INTEGER) return nullptr;
        to = put_number(to, static_cast<std::uint64_t>(sqlite3_value_int64(value)));
        break;
      case Kind::boolean: {
        const std::int64_t flag = sqlite3_value_int64(value);
        if (type != SQLITE_INTEGER || (flag | 1) != 1) return nullptr;
        to = flag != 0 ? copy_short(to, "true", 4) : copy_short(to, "false", 5);
        break;
      }
      case Kind::text: {
        if (type != SQLITE_TEXT) return nullptr;
        const std::string_view text = value_text(value);
        if (text.size() > 4 * column.leaf->size) return nullptr;  // too long, even with escapes
        make_room(2 * text.size() + 2);
        if (is_plain(text)) {
          to = copy_short(to, text.data(), text.size());
        } else if (is_readable(text) && !has_escape(text)) {
          const bool needs_quotes = text.empty() || text.find_first_of("\",\r\n") != std::string_view::npos ||
                                    std::strchr(" \t", text.front()) != nullptr ||
                                    std::strchr(" \t", text.back()) != nullptr;
          to = needs_quotes ? put_quoted(to, text) : copy_short(to, text.data(), text.size());
        } else {
          return nullptr;
        }
        if (text.size() > column.leaf->size - text_length_bytes) return nullptr;
        break;
      }
      case Kind::enumeration: {
        if (type != SQLITE_TEXT) return nullptr;
        const std::string_view text = value_text(value);
        bool is_known = false;
        for (const EnumValue& known : column.leaf->field->values) is_known = is_known || known.name == text;
        if (!is_known || !is_plain(text)) return nullptr;
        make_room(text.size());
        to = copy_short(to, text.data(), text.size());
        break;
      }
      case Kind::character: {
        const std::string_view text = value_text(value);
        if (type != SQLITE_TEXT || text.size() != 1 || !is_plain(text)) return nullptr;
        *to++ = text.front();
        break;
      }
      default: {
        const std::int64_t number = sqlite3_value_int64(value);
        if (type != SQLITE_INTEGER || !fits(column.kind, number)) return nullptr;
        to = put_number(to, number);
        break;
      }
    }
  }
  if (runs_ == Runs::named) {
    *to++ = ',';
    to = put_number(to, run_);
  }
  *to++ = '\n';
  return to;
}

std::uint64_t CsvRows::append(std::string& out, std::size_t enough) {
  std::uint64_t rows = 0;
  std::size_t used = out.size();
  const struct Rest {  // of what was made ready for a row
    ~Rest() { text.resize(end); }
    std::string& text;
    const std::size_t& end;
  } rest{out, used};
  while (!has_ended_ && used < enough && (filter_.limit == 0 || given_ < filter_.limit)) {
    try {
      has_ended_ = !statement_.step();  // another step would begin anew
    } catch (const SetupError& error) {
      throw SetupError(behind_row(*recording_->file(), topic_, run_, last_sequence_, error.error()));
    }
    if (has_ended_) break;
    if (const std::int64_t run = statement_.integer(run_column); run != run_) begin_run(run);
    Time time = from_nanoseconds(statement_.integer(time_column));
    if (is_utc_) time = line_.utc(time);
    if (out.size() < used + longest_) out.resize(2 * out.size() + longest_);
    if (const char* end = put_row(out.data() + used, time, out)) {
      used = static_cast<std::size_t>(end - out.data());
    } else {
      out.resize(used);
      append_by_codec(out, time);
      used = out.size();
    }
    last_time_ = time;
    last_sequence_ = static_cast<std::uint64_t>(statement_.integer(sequence_column));
    ++rows;
    ++given_;
  }
  return rows;
}

}  // namespace rtdata::detail
