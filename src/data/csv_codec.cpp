#include <cmath>
#include <cstring>
#include <limits>

#include "data/character.hpp"
#include "data/csv_row.hpp"
#include "data/load.hpp"
#include "data/number_text.hpp"
#include "data/utf8.hpp"
#include "rtdata/data/codec.hpp"

namespace rtdata {
namespace {

void append(std::vector<std::byte>& out, std::string_view text) {
  const auto* from = reinterpret_cast<const std::byte*>(text.data());
  out.insert(out.end(), from, from + text.size());
}

bool needs_quotes(std::string_view text) {
  return text.find_first_of("\",\r\n") != std::string_view::npos ||
         (!text.empty() && (text.front() == ' ' || text.back() == ' ' || text.front() == '\t' || text.back() == '\t'));
}

enum class WhenEmpty { plain, quoted };

void append_cell(std::string& row, std::string_view text, WhenEmpty when_empty = WhenEmpty::plain) {
  if (!needs_quotes(text) && !(text.empty() && when_empty == WhenEmpty::quoted)) {
    row += text;
    return;
  }
  row += '"';
  for (const char c : text) {
    if (c == '"') row += '"';
    row += c;
  }
  row += '"';
}

template <class T>
void append_number(std::string& row, T number) {
  char digits[detail::longest_number];
  row.append(digits, detail::put_number(digits, number));
}

template <class T>
void append_floating(std::string& row, const std::byte* from) {
  T number;
  std::memcpy(&number, from, sizeof number);
  // The sign of a NaN has no meaning, and not every reader accepts it.
  if (std::isnan(number)) {
    row += "nan";
  } else {
    append_number(row, number);
  }
}

template <class T>
bool to_number(std::string_view text, T& number) {
  return detail::read_number(text, number) == std::errc{};
}

using Cell = detail::CsvCell;

Error bad(std::string where, std::string why) {
  return {Errc::bad_data, "the text is not a row of CSV", std::move(where), std::move(why), ""};
}

/// The value of a cell for this leaf.
Result<Value> value_of(const Leaf& leaf, Cell& cell) {
  const auto wrong = [&](const char* what) {
    return Error{Errc::not_a_number, "the cell does not fit its column", "field " + leaf.path,
                 "\"" + cell.text + "\" is not " + what, ""};
  };
  if (!cell.quoted && cell.text.empty() && leaf.optional != nullptr) return Value{};
  switch (leaf.kind) {
    case Kind::boolean:
      if (bool flag = false; detail::read_boolean(cell.text, flag)) return Value(flag);
      return wrong("true or false");
    case Kind::character:
      if (const auto c = detail::character_of(detail::unescaped(cell.text))) return Value(*c);
      return wrong("a character");
    case Kind::text:
    case Kind::record:
      return Value(detail::unescaped(cell.text));
    case Kind::f32: {
      // Not through a double: rounding twice may give a wrong float.
      float number = 0;
      if (to_number(cell.text, number)) return Value(static_cast<double>(number));
      break;
    }
    case Kind::f64:
      break;
    case Kind::enumeration:
      for (const EnumValue& value : leaf.field->values) {
        if (value.name == cell.text) return Value(std::move(cell.text));
      }
      [[fallthrough]];
    default: {
      std::int64_t number = 0;
      std::uint64_t large = 0;
      if (to_number(cell.text, number)) return Value(number);
      if (to_number(cell.text, large)) return Value(large);
      if (leaf.kind == Kind::enumeration) return Value(std::move(cell.text));
      break;
    }
  }
  double number = 0;
  if (to_number(cell.text, number)) return Value(number);
  return wrong("a number in range");
}

class CsvCodec final : public Codec {
 public:
  explicit CsvCodec(CsvConfig config) : config_(config) {}

  std::string_view name() const noexcept override { return "csv"; }
  bool is_text() const noexcept override { return true; }

  Result<void> encode(const EventView& event, std::vector<std::byte>& out) override {
    row_.clear();
    if (config_.time == CsvConfig::TimeFormat::iso8601) {
      row_ += to_iso8601(event.time());
    } else {
      append_number(row_, to_nanoseconds(event.time()));
    }
    row_ += ',';
    append_text(event.origin(), WhenEmpty::plain);
    row_ += ',';
    append_number(row_, event.sequence());
    for (const Leaf& leaf : event.description().leaves()) {
      row_ += ',';
      const std::byte* from = find_value(leaf, event.payload().data());
      if (from == nullptr) continue;
      switch (leaf.kind) {
        case Kind::f64:
          append_floating<double>(row_, from);
          break;
        case Kind::f32:
          append_floating<float>(row_, from);
          break;
        case Kind::u64:
          append_number(row_, detail::load<std::uint64_t>(from));
          break;
        case Kind::i64:
        case Kind::i32:
        case Kind::i16:
        case Kind::i8:
        case Kind::u32:
        case Kind::u16:
        case Kind::u8:
          append_number(row_, detail::load_integer(leaf.kind, from));
          break;
        case Kind::character:
          append_text(detail::utf8_of(static_cast<char>(*from)), WhenEmpty::quoted);
          break;
        case Kind::text:
          append_text(detail::text_at(leaf, from), WhenEmpty::quoted);
          break;
        default:
          append_cell(row_, to_string(read(leaf, event.payload().data())), WhenEmpty::quoted);
          break;
      }
    }
    row_ += '\n';
    append(out, row_);
    return {};
  }

  Result<DecodedEvent> decode(std::span<const std::byte> bytes, const Description& description) override {
    std::string_view row{reinterpret_cast<const char*>(bytes.data()), bytes.size()};
    if (row.starts_with(detail::byte_order_mark)) row.remove_prefix(detail::byte_order_mark.size());
    auto cells = detail::split_csv(row);
    if (!cells) return std::move(cells).error();
    const auto& leaves = description.leaves();
    if (cells->size() != 3 + leaves.size()) {
      return bad("", std::to_string(cells->size()) + " columns, not " + std::to_string(3 + leaves.size()));
    }
    DecodedEvent event;
    std::int64_t nanoseconds = 0;
    if (const std::string& time = (*cells)[0].text; to_number(time, nanoseconds)) {
      event.time = from_nanoseconds(nanoseconds);
    } else {
      auto read = parse_iso8601(time);
      if (!read) return std::move(read).error();
      event.time = *read;
    }
    event.origin = detail::unescaped((*cells)[1].text);
    if (const std::string& text = (*cells)[2].text; !text.empty()) {
      std::uint64_t sequence = 0;
      if (!to_number(text, sequence)) return bad("sequence", "\"" + text + "\" is not a number");
      event.sequence = sequence;
    }
    event.payload.resize(description.size());
    for (std::size_t i = 0; i < leaves.size(); ++i) {
      auto value = value_of(leaves[i], (*cells)[3 + i]);
      if (!value) return std::move(value).error();
      if (auto done = write(leaves[i], event.payload.data(), *value); !done) return std::move(done).error();
    }
    return event;
  }

  std::string header(const Description& description) const override { return csv_header(description); }

  std::size_t first_event(std::span<const std::byte> stream) const noexcept override {
    return detail::csv_row_size({reinterpret_cast<const char*>(stream.data()), stream.size()});
  }

 private:
  void append_text(std::string_view text, WhenEmpty when_empty) {
    if (!detail::needs_escape(text)) return append_cell(row_, text, when_empty);
    escaped_.clear();
    detail::append_escaped(escaped_, text);
    append_cell(row_, escaped_, when_empty);
  }

  CsvConfig config_;
  std::string row_;
  std::string escaped_;
};

}  // namespace

std::unique_ptr<Codec> make_csv_codec(CsvConfig config) { return std::make_unique<CsvCodec>(config); }

std::string csv_header(const Description& description) {
  std::string row = "time,origin,sequence";
  for (const Leaf& leaf : description.leaves()) append_cell(row += ',', leaf.path);
  return row += '\n';
}

}  // namespace rtdata
