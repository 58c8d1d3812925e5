// Whatever bytes devices and programs send: what is stored as text is UTF-8 that every reader can read, and comes back
// equal.
#include <doctest/doctest.h>

#include <span>
#include <sstream>

#include "app/run/log.hpp"
#include "data/utf8.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/recording/export.hpp"
#include "rtdata/sinks/file.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;

namespace {

struct Note {
  text<4> words;
  char letter = 'x';
  std::optional<text<8>> maybe;
  RTDATA_FIELDS(Note, (words), (letter), (maybe))
  bool operator==(const Note&) const = default;
};

/// Texts that are no UTF-8, hold zero bytes, or look as if they were escaped.
std::vector<Note> strange_notes() {
  std::vector<Note> notes;
  for (const std::string& words :
       {std::string("\xff\xfe\xfd\xfc"), std::string("a\xe4"), std::string("a\0b", 3), std::string("\\xff"),
        std::string("\\x5c"), std::string("\\x\xff"), std::string("\xc0\x80"), std::string("\xed\xa0\x80"),
        std::string("\xf0\x9f\x98\x80"), std::string("\xe2\x82"), std::string("\\"), std::string("\\x41"),
        std::string()}) {
    Note note;
    note.words = words;
    note.letter = words.empty() ? '\0' : words[0];
    if (words.size() > 2) note.maybe = rtdata::text<8>(words + words);
    notes.push_back(note);
  }
  return notes;
}
constexpr std::uint64_t strange_texts = 11;  // of those that are no UTF-8, or have zero bytes

std::string bytes_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

/// Of every column of every table that SQLite calls text; "" when all of it is UTF-8 without zero bytes.
std::string wrong_texts(const std::string& path) {
  const auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
  auto tables = database.prepare("SELECT name FROM sqlite_schema WHERE type IN ('table', 'view')");
  std::string wrong;
  while (tables.step()) {
    const std::string table(tables.text(0));
    auto rows = database.prepare("SELECT * FROM " + sqlite::quoted(table));
    while (rows.step()) {
      for (int i = 0; i < sqlite3_column_count(rows.raw()); ++i) {
        if (sqlite3_column_type(rows.raw(), i) != SQLITE_TEXT || detail::is_readable(rows.text(i))) continue;
        wrong += table + "." + sqlite3_column_name(rows.raw(), i) + " ";
      }
    }
  }
  return wrong;
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("escapes have a way back, whatever the bytes") {
    std::uint32_t seed = 1;
    const std::string letters(
        "\\x\0"
        "05c8f\xff\xc3\xa9\xe2\x82\xac",
        14);
    for (int round = 0; round < 20000; ++round) {
      std::string text;
      for (std::uint32_t size = seed % 23; size > 0; --size) {
        seed = seed * 1664525 + 1013904223;
        text += letters[(seed >> 16) % letters.size()];
      }
      seed = seed * 1664525 + 1013904223;
      CAPTURE(text);
      std::string written;
      detail::append_escaped(written, text);
      REQUIRE(detail::is_readable(written));
      REQUIRE(detail::unescaped(written) == text);
      REQUIRE(detail::needs_escape(text) == (written != text));
      REQUIRE(detail::has_escape(written) == (written != text));
      REQUIRE(detail::is_readable(text) == (detail::readable(text) == text));
      REQUIRE(detail::is_utf8(detail::readable(text)));
    }
  }

  TEST_CASE("texts that are no UTF-8 are blobs in a recording, told once, and come back equal") {
    const Folder folder;
    const std::string path = folder / "run.db";
    const auto notes = strange_notes();
    std::vector<std::string> told;
    {
      Loop loop{Loop::Manual{}};
      loop.on_error([&](const ErrorReport& report) { told.push_back(report.error.text()); });
      SqliteSink sink(loop, {.path = path});
      Feed<Note> feed(loop, {.name = "pen", .topic = "note"});
      Feed<Note> plain(loop, {.name = "plain", .topic = "note"});
      for (const Note& note : notes) {
        feed.publish(note);
        plain.publish(Note{});
        loop.advance(2s);
      }
      feed.close();
      plain.close();
      loop.close();
    }
    CHECK(wrong_texts(path) == "");
    REQUIRE(told.size() == 1);
    CHECK(told[0].find("a text is not UTF-8: topic note, origin pen: ") == 0);
    CHECK(number(path, "SELECT count(*) FROM note WHERE typeof(words) = 'blob'") == 7);
    CHECK(number(path, "SELECT count(*) FROM note WHERE typeof(maybe) = 'blob'") == 4);
    CHECK(number(path, "SELECT count(*) FROM note WHERE words = x'fffefdfc'") == 1);
    CHECK(number(path, "SELECT count(*) FROM note WHERE words = '\\xff'") == 1);  // its four characters
    const auto recording = Recording::open(path).or_throw();
    auto rows = recording.rows({.origin = "pen"}).or_throw();
    for (const Note& note : notes) {
      const auto* row = rows.next().or_throw();
      REQUIRE(row != nullptr);
      Note same;
      std::memcpy(static_cast<void*>(&same), row->event().payload().data(), sizeof same);
      CHECK(same == note);
    }
    check_balanced(path);
    // What it is exported to, too.
    for (const char* format : {"csv", "jsonl"}) {
      CAPTURE(format);
      std::ostringstream out;
      export_rows(recording, {.format = format, .filter = {.origin = "pen"}}, out).or_throw();
      CHECK(detail::is_readable(out.str()));
      const auto codec = CodecRegistry::standard().make(format == std::string("csv") ? "csv" : "json").or_throw();
      const std::string text = out.str();
      CAPTURE(text);
      auto left = std::as_bytes(std::span(text));
      if (format == std::string("csv")) left = left.subspan(codec->first_event(left));
      for (const Note& note : notes) {
        const std::size_t size = codec->first_event(left);
        CHECK(decode<Note>(*codec, left.first(size)).or_throw().data == note);
        left = left.subspan(size);
      }
    }
  }

  TEST_CASE("texts that are no UTF-8 are escaped in files, counted and told") {
    for (const char* format : {"csv", "json"}) {
      CAPTURE(format);
      const Folder folder;
      const std::string path = folder / "notes";
      std::vector<std::string> told;
      Loop loop{Loop::Manual{}};
      loop.on_error([&](const ErrorReport& report) { told.push_back(report.error.text()); });
      FileSink sink(loop, {.path = path, .format = format});
      Feed<Note> feed(loop, {.name = "pen", .topic = "note"});
      const auto notes = strange_notes();
      feed.publish(notes.front());
      loop.advance(2s);
      for (std::size_t i = 1; i < notes.size(); ++i) feed.publish(notes[i]);
      loop.advance(2s);
      feed.close();
      sink.close();
      loop.poll();
      CHECK(detail::is_readable(bytes_of(path)));
      REQUIRE(told.size() == 2);
      CHECK(told[0].find("a text is not UTF-8: topic note, origin pen: ") == 0);
      CHECK(told[1].find(std::to_string(strange_texts) + " texts were not UTF-8: ") == 0);
    }
  }

  TEST_CASE("notes, configurations, errors and reasons of health that are no UTF-8 are recorded as UTF-8") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Runtime runtime({.name = "b\xe4nch", .notes = "\xff", .configuration = "// \xe4\n{}"});
      runtime.on_log([](const LogRecord&) {});
      Loop loop(runtime, {});
      loop.on_error([&](const ErrorReport&) { loop.stop(); });
      SqliteSink sink(loop, {.path = path});
      Sensor<Climate> sensor(loop, {.name = "room \xc3\xa4", .topic = "room", .rate = 100_Hz}, []() -> Result<Climate> {
        return Error{Errc::io_failed, "no \xff answer", "\xe4", std::string("\0", 1), ""};
      });
      loop.run();
      sensor.close();
      loop.close();
    }
    CHECK(wrong_texts(path) == "");
    CHECK(number(path, "SELECT count(*) FROM rtdata_run WHERE name = 'b\\xe4nch' AND notes = '\\xff'") == 1);
    CHECK(number(path, "SELECT count(*) FROM rtdata_error WHERE text LIKE 'no \\xff answer: \\xe4: \\x00%'") > 0);
    CHECK(number(path, "SELECT count(*) FROM rtdata_health WHERE reason LIKE 'no \\xff%'") > 0);
    check_balanced(path);
  }

  TEST_CASE("names and units that are no UTF-8 are refused at set-up") {
    Loop loop{Loop::Manual{}};
    CHECK_THROWS_WITH_AS(Feed<Note>(loop, {.name = "\xe4", .topic = "note"}), doctest::Contains("UTF-8"), SetupError);
    CHECK_FALSE(DescriptionBuilder("r")
                    .field("a", Kind::f64,
                           "\xb0"
                           "C")
                    .build());
    CHECK_FALSE(DescriptionBuilder("r").enumeration("a", {{"\xe4", 1}}, Kind::i8).build());
  }

  TEST_CASE("the log is UTF-8 whatever it is told") {
    const Folder folder;
    {
      app::Log log;
      log.open(folder / "log", {.level = LogLevel::debug}).or_throw();
      log.write(LogLevel::info, "sensor \xe4", std::string("a\0\xff", 3), "");
    }
    CHECK(bytes_of(folder / "log").find("info sensor \\xe4: a\\x00\\xff\n") != std::string::npos);
  }
}
