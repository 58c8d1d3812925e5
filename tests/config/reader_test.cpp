#include <doctest/doctest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <clocale>
#include <cstdio>
#include <filesystem>
#include <fstream>

#include "rtdata/config/format.hpp"

using namespace rtdata;

namespace {

/// The only problem that this text has: "LINE:COLUMN: PATH: MESSAGE".
std::string mistake(std::string_view text) {
  const ConfigDocument document = parse_config(text, "f");
  if (document.problems.size() != 1) return std::to_string(document.problems.size()) + " problems";
  return document.problems[0].text().substr(2);
}

std::string id_of(std::string_view text) {
  const ConfigDocument document = parse_config(text, "f");
  return document.good() ? "good" : document.problems[0].id;
}

/// A folder that is gone when the test is over.
struct Folder {
  Folder() { REQUIRE(::mkdtemp(path.data()) != nullptr); }
  ~Folder() { std::filesystem::remove_all(path); }
  std::string file(const std::string& name, std::string_view content) const {
    std::ofstream(path + "/" + name, std::ios::binary) << content;
    return path + "/" + name;
  }
  std::string path = "/tmp/rtdata-config-XXXXXX";
};

/// KEY = TEXT lines below [SECTION] lines: a format from outside the library.
class IniFormat final : public ConfigFormat {
 public:
  std::string_view name() const override { return "INI"; }
  std::vector<std::string> extensions() const override { return {".ini"}; }
  ConfigItem read(std::string_view text, const std::string& file, Problems& problems) const override {
    ConfigBuilder builder(file, problems);
    builder.begin_object({1, 1});
    for (std::size_t line = 1; !text.empty(); ++line) {
      const std::size_t end = std::min(text.find('\n'), text.size());
      const std::string_view content = text.substr(0, end);
      text.remove_prefix(std::min(end + 1, text.size()));
      const std::size_t equals = content.find(" = ");
      if (content.starts_with('[')) {
        if (builder.depth() > 1) builder.end();
        builder.key(content.substr(1, content.find(']') - 1), {line, 2});
        builder.begin_object({line, 1});
      } else if (equals != std::string_view::npos) {
        builder.key(content.substr(0, equals), {line, 1});
        builder.string(content.substr(equals + 3), {line, equals + 4});
      } else if (!content.empty()) {
        problems.add("syntax", {file, line, 1}, builder.path(), "expected KEY = TEXT");
      }
    }
    return builder.finish();
  }
};

}  // namespace

TEST_SUITE("config") {
  TEST_CASE("US-19 a syntax error has line, column, path and a sentence") {
    CHECK(mistake("{\"a\": 1,}") == "1:8: there is an extra comma before '}'");
    CHECK(mistake("[1,\n 2,\n]") == "2:3: there is an extra comma before ']'");
    CHECK(mistake("[1,,2]") == "1:4: there is an extra comma");
    CHECK(mistake("{\"a\": 1\n \"b\": 2}") ==
          "2:2: expected ',' or '}', found the string \"b\"; is a comma missing before it?");
    CHECK(mistake("{\"a\" 1}") == "1:6: expected ':' after the key, found '1'");
    CHECK(mistake("{\"a\": }") == "1:7: expected a value, found '}'");
    CHECK(mistake("{a: 1}") == "1:2: expected a key in \"quotes\", found 'a'");
    CHECK(mistake("{\"s\": [{'a': 1}]}") == "1:9: s[0]: text needs double quotes (\"), not single ones");
    CHECK(mistake("{\"a\": 1\n# my bench\n}") == "2:1: a comment begins with //, not with '#'");
    CHECK(mistake("# my bench\n{}") == "1:1: a comment begins with //, not with '#'");
    CHECK(mistake("{\u201cname\u201d: 1}") ==
          "1:2: text needs plain double quotes (\"), not typographic ones: '\u201cname\u201d'");
    CHECK(mistake("{\"name\": \u201ebench\u201c}").starts_with("1:10: text needs plain double quotes"));
    CHECK(mistake("[True]") == "1:2: expected a value, found 'True'; text needs \"quotes\" (did you mean \"true\"?)");
    CHECK(mistake("{\"a\": 10 ms}") == "1:10: expected ',' or '}', found 'ms'; is a comma missing before it?");
    CHECK(mistake("{\"a\": 10ms}") ==
          "1:7: '10ms' is not a number as JSON writes it; text, and values with a unit, need \"quotes\"");
    for (const char* number : {"01", "1.", ".5", "+1", "0x1F", "-", "1-2", "1e", "--1"})
      CHECK_MESSAGE(mistake(std::string("[").append(number).append("]")).find("is not a number as JSON writes it") !=
                        std::string::npos,
                    number);
    CHECK(mistake("{\"a\": [1, 2}") ==
          "1:12: a: expected ']' to close the list that begins at line 1, column 7, found '}'");
    CHECK(mistake("{\"a\":\n  [1, {\"y\": [") ==
          "2:14: a[1].y: the file ends here, but the list that begins at line 2, column 13 is not closed");
    CHECK(mistake("{\"a\": \"abc\n}") == "1:7: this string is not closed: its second '\"' is missing on this line");
    CHECK(mistake("[\"a\tb\"]").starts_with("1:4: this character cannot be in a string: control character U+0009"));
    CHECK(mistake("[\"a\\qb\"]") == "1:5: this character cannot be in a string: forbidden character after backslash");
    CHECK(mistake("[1 /* x ]") == "1:4: this comment is not closed: there is no '*/'");
    CHECK(mistake("[1, / 2]") == "1:5: a '/' alone is not a comment: write // or /* */");
    CHECK(mistake("{} {}") == "1:4: the configuration has ended, but here is '{'");
    CHECK(mistake("// only") == "1:8: expected a value, found the end of the file");
    CHECK(id_of("[1,]") == "syntax");
    CHECK(parse_config("[1,]").root.is_null());
  }

  TEST_CASE("US-19 columns count characters, also after comments, tabs and line ends of other systems") {
    CHECK(mistake("[\"\xc3\xa9\xe2\x82\xac\xf0\x9f\x98\x80\", x]").starts_with("1:9: "));
    CHECK(mistake("/* \xc3\xa9 */ [\t?]").starts_with("1:11: "));
    CHECK(mistake("[1,\r\n 2,\r\n ?]").starts_with("3:2: "));
    const ConfigItem root = parse_config("// \xc3\xa9\n/* a\n b */ {\"k\": /* c */ \"v\", // d \"e\n \"l\": [1]}")
                                .or_throw();
    CHECK(root.place().text() == "configuration.json:3:7");
    CHECK(root.at("k").place().text() == "configuration.json:3:21");
    CHECK(root.at("k").key_place().text() == "configuration.json:3:8");
    CHECK(root.at("l[0]").place().text() == "configuration.json:4:8");
  }

  TEST_CASE("US-19 a key that is there twice is an error that names both places") {
    const ConfigDocument document = parse_config("{\"a\": 1, \"b\": {\"c\": 1,\n \"c\": {}, \"c\": 3},\n \"a\": 2}",
                                                 "f");
    CHECK(document.problems.text() ==
          "f:2:2: b.c: this key is already at f:1:16 [duplicate-key]\n"
          "f:2:11: b.c: this key is already at f:1:16 [duplicate-key]\n"
          "f:3:2: a: this key is already at f:1:2 [duplicate-key]\n");
    CHECK(document.root.at("a").get<int>() == 1);
    CHECK(id_of("{\"a\": 1, \"\\u0061\": 2}") == "duplicate-key");
  }

  TEST_CASE("US-19 what was wrong before a syntax error is told as well") {
    const ConfigDocument document = parse_config("{\"a\": 1, \"a\": 2, b}", "f");
    CHECK(document.problems.text() ==
          "f:1:10: a: this key is already at f:1:2 [duplicate-key]\n"
          "f:1:18: expected a key in \"quotes\", found 'b' [syntax]\n");
  }

  TEST_CASE("US-19 comments and a byte order mark are allowed") {
    CHECK(parse_config("\xef\xbb\xbf{} // end").good());
    CHECK(parse_config("/**/ [1, // one\n /* two */ 2 /***/]//").or_throw().size() == 2);
    CHECK(mistake("\xef\xbb\xbf[x]").starts_with("1:2: "));
    CHECK(parse_config("[\"// no /* comment\"]").or_throw().at(0).get<std::string>() == "// no /* comment");
  }

  TEST_CASE("US-19 odd texts are errors and nothing worse") {
    CHECK(mistake("") == " the configuration is empty");
    CHECK(mistake(" \n\t") == " the configuration is empty");
    CHECK(mistake("\xef\xbb\xbf") == " the configuration is empty");
    CHECK(mistake("[\"a\xff\"]") == "1:4: this byte is not UTF-8: save the file as UTF-8");
    CHECK(mistake("{}\n// \xc3") == "2:4: this byte is not UTF-8: save the file as UTF-8");
    for (const char* bad : {"\xc0\x80", "\xe0\x80\x80", "\xed\xa0\x80", "\xf4\x90\x80\x80", "\x80", "\xf0\x9f\x98"})
      CHECK(id_of(std::string("[\"").append(bad).append("\"]")) == "bad-encoding");
    CHECK(mistake(std::string_view("{}\0{", 4)) == "1:3: a NUL byte: the file is not text");
    CHECK(id_of("[1e400]") == "out-of-range");
    CHECK(mistake("{\"a\": -1e400}") == "1:7: the number -1e400 is too large");
    CHECK(parse_config("[1e-400, -0, 123456789012345678901234567890]").good());
    const std::string deep(64, '[');
    CHECK(parse_config(deep + std::string(64, ']')).good());
    CHECK(mistake(deep + "[") == "1:65: " + [] {
      std::string path;
      for (int i = 0; i < 63; ++i) path += "[0]";
      return path;
    }() + ": more than 64 levels of nesting");
    CHECK(id_of(std::string(1000000, '[')) == "too-deep");
    std::string objects;
    for (int i = 0; i < 100000; ++i) objects += "{\"a\":";
    CHECK(id_of(objects) == "too-deep");
  }

  TEST_CASE("US-19 a file of megabytes is read in time that grows with its size") {
    std::string text = "[\n";
    for (int i = 0; i < 100000; ++i)
      text += (i ? ",\n" : "") + std::string("{\"n\": ") + std::to_string(i) + ", \"s\": \"some text\"}";
    text += "]";
    REQUIRE(text.size() > 3000000);
    const ConfigItem root = parse_config(text).or_throw();
    CHECK(root.size() == 100000);
    CHECK(root.at(99999, "n").place().line == 100001);
    std::string keys = "{";
    for (int i = 0; i < 50000; ++i) keys += (i ? ", \"k" : "\"k") + std::to_string(i) + "\": 1";
    CHECK(parse_config(keys + "}").or_throw().size() == 50000);
    CHECK(mistake(std::string("[\"").append(5000000, 'x')).ends_with("is missing on this line"));
  }

  TEST_CASE("US-19 numbers are read the same under every locale") {
    const std::string before = std::setlocale(LC_NUMERIC, nullptr);
    for (const char* locale : {"de_DE.UTF-8", "fr_FR.UTF-8", "C"}) {
      if (std::setlocale(LC_NUMERIC, locale) == nullptr) continue;
      const ConfigItem root = parse_config("[1.50]").or_throw();
      CHECK(root.at(0).get<double>() == 1.5);
      CHECK(root.to_json(ConfigItem::Layout::one_line) == "[1.50]");
    }
    std::setlocale(LC_NUMERIC, before.c_str());
  }

  TEST_CASE("a problem is shown with its line and a caret under its column") {
    const ConfigDocument document = parse_config("{\n\t\"\xc3\xa9\": tru\r\n}", "f.json");
    CHECK(document.report() ==
          "f.json:2:7: expected a value, found 'tru'; text needs \"quotes\" (did you mean \"true\"?) [syntax]\n"
          "   \"\xc3\xa9\": tru\n"
          "        ^\n");
    const ConfigDocument wide = parse_config(
        std::string("[").append(3000, ' ').append("?").append(3000, ' ').append("]"), "f.json");
    const std::string excerpt = wide.excerpt(wide.problems[0]);
    CHECK(excerpt.size() < 250);
    const std::size_t line_end = excerpt.find('\n');
    CHECK(excerpt.find('?') == excerpt.find('^') - line_end - 1);
    CHECK(parse_config("", "f.json").report() == "f.json: the configuration is empty [empty]\n");
    Problem elsewhere = wide.problems[0];
    elsewhere.place.line = 9;
    CHECK(wide.excerpt(elsewhere).empty());
    elsewhere.place = {"other", 1, 1};
    CHECK(wide.excerpt(elsewhere).empty());
  }

  TEST_CASE("US-22 files that cannot be read are told apart") {
    const Folder folder;
    const auto text_of = [](const std::string& file) { return load_config(file).problems.text(); };
    CHECK(load_config(folder.file("good.json", "{\"a\": [1]}")).root.at("a[0]").get<int>() == 1);
    CHECK(load_config(folder.file("none", "{}")).good());
    CHECK(load_config(folder.file("UPPER.JSON", "{}")).good());
    CHECK(text_of(folder.path) == folder.path + ": cannot read the configuration: Is a directory [cannot-read]\n");
    CHECK(text_of("/nowhere/x.json") ==
          "/nowhere/x.json: cannot read the configuration: No such file or directory [cannot-read]\n");
    CHECK(text_of("/proc/self/mem") ==
          "/proc/self/mem: cannot read the configuration: Input/output error [cannot-read]\n");
    CHECK(text_of(folder.file("empty.json", "")) == folder.path + "/empty.json: the configuration is empty [empty]\n");
    const std::string closed = folder.file("closed.json", "{}");
    ::chmod(closed.c_str(), 0);
    if (::access(closed.c_str(), R_OK) != 0)
      CHECK(text_of(closed) == closed + ": cannot read the configuration: Permission denied [cannot-read]\n");
    CHECK(text_of(folder.file("x.yaml", "a: 1")) == folder.path +
                                                        "/x.yaml: no configuration format has the extension "
                                                        "\".yaml\"; available: .json, .jsonc [unknown-format]\n");
    CHECK(load_config("/dev/zero").problems[0].id == "too-large");
    CHECK_THROWS_AS((void)load_config("/nowhere/x.json").or_throw(), ConfigError);
  }

  TEST_CASE("US-22 the format is exchanged for one from outside") {
    ConfigFormats formats;
    formats.add(std::make_unique<IniFormat>());
    CHECK(formats.extensions() == std::vector<std::string>{".json", ".jsonc", "", ".ini"});
    const Folder folder;
    const std::string file = folder.file("bench.ini", "name = bench\n\n[gps]\nrate = 5 Hz\n[adc]\nfile = adc0\n");
    const ConfigItem root = load_config(file, formats).or_throw();
    CHECK(root.at("name").get<std::string>() == "bench");
    CHECK(root.at("gps.rate").get<Rate>() == Rate::hertz(5));
    CHECK(root.at("adc.file").place() == ConfigPlace{file, 6, 8});
    CHECK(root.at("adc").key_place() == ConfigPlace{file, 5, 2});
    const ConfigDocument wrong = parse_config("a = 1\na = 2\n[s]\nnothing", "w.ini", formats);
    CHECK(wrong.problems.text() ==
          "w.ini:2:1: a: this key is already at w.ini:1:1 [duplicate-key]\n"
          "w.ini:4:1: s: expected KEY = TEXT [syntax]\n");
    CHECK(load_config(folder.file("x.json", "{}"), formats).good());
  }
}
