#include "config/read/json_reader.hpp"

#include <nlohmann/json.hpp>

#include "config/read/json_mistake.hpp"
#include "config/read/text_scanner.hpp"

namespace rtdata {
namespace {

using Json = nlohmann::json;

/// Receives what the library reads, finds each value's place in the text and hands both to the builder.
class Handler {
 public:
  Handler(std::string_view text, const std::string& file, Problems& problems)
      : file_(file), problems_(problems), scanner_(text), builder_(file, problems) {}

  bool null() { return builder_.null(value()), true; }
  bool boolean(bool value_read) { return builder_.boolean(value_read, value()), true; }
  bool number_integer(std::int64_t number) { return builder_.integer(number, value()), true; }
  bool number_unsigned(std::uint64_t number) { return builder_.integer(number, value()), true; }
  bool number_float(double number, const std::string&) {
    const ConfigBuilder::Position position = value();
    builder_.number(number, previous_.text, position);  // the library's text of it has the locale's decimal point
    return true;
  }
  bool string(const std::string& text) { return builder_.string(text, value()), true; }
  bool binary(const Json::binary_t&) { return true; }  // not in JSON
  bool start_object(std::size_t) {
    const bool good = builder_.begin_object(value());
    open_.push_back(true);
    after_value_ = false;
    return good;
  }
  bool start_array(std::size_t) {
    const bool good = builder_.begin_array(value());
    open_.push_back(false);
    after_value_ = false;
    return good;
  }
  bool key(const std::string& name) {
    builder_.key(name, value());
    after_key_ = true;
    return true;
  }
  bool end_object() { return end(); }
  bool end_array() { return end(); }

  bool parse_error(std::size_t bytes_read, const std::string&, const Json::exception& error) {
    const std::string words = error.what();
    JsonMistake mistake;
    mistake.bytes_read = bytes_read;
    mistake.library_text = words;
    mistake.number_too_large = error.id == 406;
    mistake.in_object = !open_.empty() && open_.back();
    mistake.in_array = !open_.empty() && !open_.back();
    mistake.after_key = after_key_;
    mistake.after_value = after_value_;
    mistake.previous = previous_;
    mistake.opened = builder_.innermost();
    Problem problem = explain(mistake, scanner_);
    problem.place.file = file_;
    problem.path = builder_.path();
    problems_.add(std::move(problem));
    return false;
  }

  ConfigItem finish() { return builder_.finish(); }

 private:
  ConfigBuilder::Position value() {
    after_key_ = false;
    after_value_ = true;
    previous_ = scanner_.next_value();
    return previous_.position;
  }
  bool end() {
    value();
    builder_.end();
    open_.pop_back();
    return true;
  }

  const std::string& file_;
  Problems& problems_;
  TextScanner scanner_;
  TextScanner::Token previous_;
  ConfigBuilder builder_;
  std::vector<bool> open_;  ///< true: an object
  bool after_key_ = false;
  bool after_value_ = false;
};

class JsonFormat final : public ConfigFormat {
 public:
  std::string_view name() const override { return "JSON"; }
  std::vector<std::string> extensions() const override { return {".json", ".jsonc", ""}; }
  ConfigItem read(std::string_view text, const std::string& file, Problems& problems) const override {
    Handler handler(text, file, problems);
    if (!Json::sax_parse(text.begin(), text.end(), &handler, nlohmann::detail::input_format_t::json, true, true))
      return ConfigItem();
    return handler.finish();
  }
};

}  // namespace

std::unique_ptr<ConfigFormat> make_json_format() { return std::make_unique<JsonFormat>(); }

}  // namespace rtdata
