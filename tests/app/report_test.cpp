// rtdata report: a page about a run, whatever the recording holds.
#include <doctest/doctest.h>

#include <cmath>
#include <fstream>
#include <set>
#include <sstream>

#include "app/control/commands.hpp"
#include "app/core/recording_commands.hpp"
#include "app/inspect/html.hpp"
#include "app/inspect/report_figures.hpp"
#include "app/process.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "rtdata/fsm/machine.hpp"
#include "rtdata/sensors/limit.hpp"
#include "sinks/recordings.hpp"

using namespace recordings;
using rtdata::app::report;
using rtdata::app::ReportOptions;
using rtdata::test::has;

namespace {

struct Made {
  int status;
  std::string page, err;
};

Made made(const std::string& path, const std::optional<std::string>& run = {}) {
  std::ostringstream out, err;
  const int status = report({.database = path, .run = run, .file = "-"}, out, err);
  return {status, out.str(), err.str()};
}

std::size_t times_in(const std::string& text, const std::string& part) {
  std::size_t count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + part.size())) ++count;
  return count;
}

/// What is wrong with a page; empty: each element is closed in its place, each attribute is in quotes, nothing is
/// fetched or run, each id is there once, and what is used is there.
std::string mistakes_in(const std::string& page) {
  if (!page.starts_with("<!DOCTYPE html>\n<html")) return "it does not begin as a page";
  for (const char* const none : {"<script", "http:", "https:", "@import", "url(", "<img", "<link", "javascript:"})
    if (has(page, none)) return std::string("it has ") + none;
  std::vector<std::string> open;
  std::set<std::string> ids, used;
  std::size_t at = page.find("<html");
  while (at < page.size()) {
    const std::size_t begin = page.find('<', at);
    const std::string text = page.substr(at, begin - at);
    const bool is_style = !open.empty() && open.back() == "style";
    if (!is_style && text.find_first_of(">\"'") != std::string::npos) return "a text has markup: " + text;
    for (std::size_t sign = text.find('&'); sign != std::string::npos; sign = text.find('&', sign + 1)) {
      const std::string word = text.substr(sign, text.find(';', sign) - sign + 1);
      if (!std::set<std::string>{"&amp;", "&lt;", "&gt;", "&quot;", "&#39;"}.contains(word))
        return "a text has " + word;
    }
    if (begin == std::string::npos) break;
    std::size_t end = begin + 1;
    for (bool in_quotes = false; end < page.size() && (in_quotes || page[end] != '>'); ++end) {
      if (page[end] == '"') in_quotes = !in_quotes;
      if (page[end] == '<') return "a tag within a tag: " + page.substr(begin, 60);
    }
    std::string tag = page.substr(begin + 1, end - begin - 1);
    at = end + 1;
    if (tag.starts_with("/")) {
      if (open.empty() || open.back() != tag.substr(1)) return "not closed before " + tag;
      open.pop_back();
      continue;
    }
    const bool is_closed = tag.ends_with("/");
    const std::string name = tag.substr(0, tag.find_first_of(" /"));
    for (const auto& [attribute, to] : {std::pair{" id=\"", &ids}, {" href=\"#", &used}}) {
      const std::size_t from = tag.find(attribute);
      if (from == std::string::npos) continue;
      const std::size_t first = from + std::string(attribute).size();
      const std::string id = tag.substr(first, tag.find('"', first) - first);
      if (!to->insert(id).second && to == &ids) return "two have the id " + id;
    }
    if (!is_closed && name != "meta") open.push_back(name);
  }
  for (const std::string& id : used)
    if (!ids.contains(id)) return "there is no " + id;
  return open.empty() ? "" : "not closed: " + open.back();
}

#define CHECK_PAGE(made)                 \
  CHECK((made).err == "");               \
  CHECK((made).status == 0);             \
  CHECK(mistakes_in((made).page) == ""); \
  CHECK(has((made).page, "</html>\n"))

/// The page without its pictures and style, in which what differs with each run of the test has names.
std::string told(std::string page, const std::string& path) {
  for (const auto& [from, until] : {std::pair{"<style>", "</style>"}, {"<svg ", "</svg></svg>"}}) {
    for (std::size_t at = page.find(from); at != std::string::npos; at = page.find(from, at + 1))
      page.replace(at, page.find(until, at) + std::string(until).size() - at, "<->");
  }
  const Recording recording = Recording::open(path).or_throw();
  const RunReport run = verify(recording).or_throw().runs.at(0);
  for (const auto& [text, name] : {std::pair{run.info.uuid, "UUID"},
                                   {run.info.program + " on " + run.info.host, "PROGRAM on HOST"},
                                   {run.checksum_text(), "CHECKSUM"}}) {
    const std::size_t at = page.find(text);
    REQUIRE(at != std::string::npos);
    page.replace(at, text.size(), name);
  }
  const std::size_t made_at = page.find("Made ") + 5;
  page.replace(made_at, page.find(" UTC", made_at) - made_at, "NOW");
  return page;
}

std::string section(const std::string& page, const std::string& heading) {
  const std::size_t at = page.find("<h2>" + heading + "</h2>");
  if (at == std::string::npos) return "";
  return page.substr(at, page.find("<h2>", at + 4) - at);
}

/// Numbers that no picture has room for, and none.
struct Odd {
  double value = 0;
  std::optional<double> maybe;
  RTDATA_FIELDS(Odd, (value), (maybe))
};

struct Numbers {
  double a = 0, b = 0, c = 0, d = 0, e = 0, f = 0, g = 0, h = 0, i = 0, j = 0;
  RTDATA_FIELDS(Numbers, (a), (b), (c), (d), (e), (f), (g), (h), (i), (j))
};

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("FW-5 report: texts are text, whatever they hold") {
    CHECK(app::html_text("<script>alert(\"1\" & '2')</script>") ==
          "&lt;script&gt;alert(&quot;1&quot; &amp; &#39;2&#39;)&lt;/script&gt;");
    CHECK(app::html_text("Grün 20 °C") == "Grün 20 °C");
    CHECK(app::html_text(std::string("a\0b\xff\x1b[31m\n", 10)) == "a?b??[31m?");
    CHECK(app::html_text(std::string(4096, '&'), 10) == "&amp;&amp;&amp;&amp;&amp;&amp;&amp;&amp;&amp;~");
  }

  TEST_CASE("FW-5 report: a run with gaps, its verdict, its curves and means with what they are of") {
    const Folder folder;
    const std::string path = make(folder);
    const Made all = made(path);
    CHECK_PAGE(all);
    CHECK(section(all.page, "What is missing") == R"(<h2>What is missing</h2>
<p>not detectable: what the source of every/thing lost itself</p>
<p>lost of room/climate in run 1: missed 4, failed 2</p>
<table>
<thead><tr><th>topic</th><th>of</th><th>why</th><th class="r">gaps</th><th class="r">ticks lost</th><th class="r">time</th><th>first</th><th>last</th></tr></thead>
<tr><td>room/climate</td><td>room</td><td>failed: io-failed</td><td class="r">1</td><td class="r">2</td><td class="r">10 ms</td><td class="t">22:13:21.000</td><td class="t">22:13:21.010</td></tr>
<tr><td>room/climate</td><td>room</td><td>missed: loop held</td><td class="r">1</td><td class="r">4</td><td class="r">30 ms</td><td class="t">22:13:25.000</td><td class="t">22:13:25.030</td></tr>
</table>

)");
    // The words of verify, and not others.
    std::ostringstream verified_as, err;
    CHECK(app::verify({.database = path, .run = "1"}, verified_as, err) == 0);
    std::string words = verified_as.str();
    words.replace(0, path.size(), "run.db");
    CHECK(has(all.page, "<pre>" + app::html_text(words.substr(0, words.find('\n'))) + "\n"));
    std::istringstream lines(words);
    for (std::string line; std::getline(lines, line);) CHECK(has(all.page, app::html_text(line, 1000) + "\n"));
    CHECK(has(all.page, "<div class=\"verdict part\"><b>LOST: 6 ticks of room/climate"));
    const std::string temperature = all.page.substr(all.page.find("<b>room/climate.temperature</b>"));
    CHECK(temperature.starts_with(
        "<b>room/climate.temperature</b> <span class=\"unit\">[Cel]</span></span><span class=\"lost\">6 lost</span>"
        "<span class=\"range\">least 1 at 22:13:20.000, most 1001 at 22:13:30.040, mean 501.8 over 99.4 % of the "
        "time</span>"));
    CHECK(has(
        temperature.substr(0, 500),
        "<span class=\"range lost\">failed: io-failed, 2 lost in 1 gap; missed: loop held, 4 lost in 1 gap</span>"));
    CHECK(has(all.page, "always 40 over 99.4 % of the time"));
    CHECK(has(all.page, "<title>22:13:21.000 to 22:13:21.010 failed: io-failed, 2 lost in 1 gap</title>"));
    // Both fields of the sensor have the shades of one.
    CHECK(times_in(all.page, "<g class=\"gap\" id=\"gap") == 1);
    CHECK(times_in(all.page, "<use href=\"#gap0\"/>") == 1);
    CHECK(times_in(all.page, "<figure>") == times_in(all.page, "</svg></svg></figure>"));
    const RunReport run = verified(path).runs.at(0);
    CHECK(has(all.page, "<code>" + run.checksum_text() + "</code>"));
    CHECK(has(all.page, "<code>rtdata verify run.db --run 1 --json</code>"));
    CHECK(has(verified(path).to_json(), "\"checksum\": \"" + run.checksum_text() + "\""));
    // What is no number, of every kind, is named.
    CHECK(has(all.page, "every/thing.name (text)"));
    CHECK(has(all.page, "every/thing.state (enum)"));
    CHECK(has(all.page, "; some are infinite"));
  }

  TEST_CASE("FW-5 report: the whole page of a small run") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Sensor<Climate> room(loop, {.name = "room", .rate = 10_Hz}, [&]() -> Result<Climate> { return Climate{20, 50}; });
      loop.advance(1s);
      room.close();
      CHECK(loop.close() == 0);
    }
    const Made all = made(path);
    CHECK_PAGE(all);
    CHECK(told(all.page, path) == R"(<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Run 1 - run.db</title>
<-></head>
<body>
<h1>Run 1</h1>
<p>Run 1 of run.db, 2023-11-14 22:13:20 to 2023-11-14 22:13:21 UTC, 1.0 s</p>
<div class="verdict good"><b>nothing lost: 11 rows</b><pre>run.db

run 1  2023-11-14T22:13:20Z to 2023-11-14T22:13:21Z  balanced
  nothing lost: 11 rows
  11 rows of 1 origin; 11 offered = 11 stored + 0 dropped
  11 ticks scheduled; 0 missed, 0 failed, 0 late; 0 gaps

balanced: rows, gaps and schedule agree with the account.
This shows that the recording is consistent with itself; it does not prove that
it was not forged.
</pre>
</div>
<table>
<tr><th>recorded</th><td>2023-11-14 22:13:20.000 to 2023-11-14 22:13:21.000 UTC (closed)</td></tr>
<tr><th>by</th><td>PROGRAM on HOST</td></tr>
<tr><th>holds</th><td>11 rows of 1 origin</td></tr>
<tr><th>run id</th><td>UUID</td></tr>
<tr><th>checksum</th><td><code>CHECKSUM</code>, of all that the recording has of the run. <code>rtdata verify run.db --run 1 --json</code> computes it from the recording again, and finds what was changed.</td></tr>
</table>

<h2>What is missing</h2>
<p>Nothing.</p>

<h2>Curves</h2>
<p class="small">A line shows the mean of each 2 ms, and the area around it the range from least to most. Red: data is missing.</p>
<figure><figcaption><span><b>room.temperature</b> <span class="unit">[Cel]</span></span><span class="there">all there</span><span class="range">always 20 over all of the time</span></figcaption>
<-></figure>
<figure><figcaption><span><b>room.humidity</b> <span class="unit">[%RH]</span></span><span class="there">all there</span><span class="range">always 50 over all of the time</span></figcaption>
<-></figure>

<h2>Who measured</h2>
<table>
<thead><tr><th>topic</th><th>of</th><th class="r">stored</th><th class="r">ticks</th><th class="r">missed</th><th class="r">failed</th><th class="r">late</th><th class="r">unreadable</th><th class="r">lost by source</th><th class="r">dropped</th><th class="r">pruned</th></tr></thead>
<tr><td>room</td><td>room</td><td class="r">11</td><td class="r">11</td><td class="r">0</td><td class="r">0</td><td class="r">0</td><td class="r">0</td><td class="r">-</td><td class="r">0</td><td class="r">0</td></tr>
</table>
<p class="small">-: the sensor has no schedule, or does not number its samples.</p>

<h2>Clock</h2>
<p>The time of day was read 2 times (system 2). How far UTC is wrong is not known: the machine did not say how well its clock was set.</p>
<p class="small">Made NOW UTC by <code>rtdata report run.db --run 1</code>. All times are UTC.</p>
</body></html>
)");
  }

  TEST_CASE("FW-5 report: what happened is listed, and marked in each picture; limits are drawn") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      Feed<Climate> board(loop, {.name = "board"});
      const LimitSensor limit(loop, {.name = "heat"}, {.on = "board", .field = "temperature", .high = 50});
      Feed<app::CommandRecord> commands(loop, {.name = "rtdata-commands", .topic = app::command_topic});
      fsm::Machine machine(loop, {.name = "door", .start = "shut"});
      machine.add_state("shut");
      machine.add_state("open");
      machine.add_transition({.from = "shut", .to = "open", .on = "knock", .cause = "somebody"});
      machine.start();
      for (int i = 0; i < 100; ++i) {
        board.publish({20.0 + (i == 50 ? 40 : 0), 1});
        if (i == 60) commands.publish({"note it is hot", "uid 7", true, "noted"});
        if (i == 70) commands.publish({"set fan 3", "uid 8", false, "there is no output fan"});
        if (i == 80) machine.raise("knock");
        loop.advance(100ms);
      }
      loop.close();
    }
    written_as(
        path,
        "UPDATE rtdata_run SET configuration = '{\"sensors\": [{\"name\": \"heat\", \"type\": \"limit\", \"on\": "
        "\"board\", \"field\": \"temperature\", \"low\": -1000, \"high\": 50}, {\"type\": 3}, 4]}'");
    const Made all = made(path);
    CHECK_PAGE(all);
    CHECK(section(all.page, "What happened") == R"(<h2>What happened</h2>
<table>
<thead><tr><th class="r">no.</th><th>time</th><th>kind</th><th>of, or by</th><th>what</th></tr></thead>
<tr><td class="r">1</td><td class="t">22:13:20.000</td><td>alarm</td><td>heat</td><td>normal, at 20</td></tr>
<tr><td class="r">2</td><td class="t">22:13:20.000</td><td>state</td><td>door</td><td>shut (start)</td></tr>
<tr><td class="r">3</td><td class="t">22:13:25.000</td><td>alarm</td><td>heat</td><td>high, at 60, limit 50</td></tr>
<tr><td class="r">4</td><td class="t">22:13:26.000</td><td>note</td><td>uid 7</td><td>it is hot</td></tr>
<tr><td class="r">5</td><td class="t">22:13:26.000</td><td>alarm</td><td>heat</td><td>normal, at 20</td></tr>
<tr><td class="r">6</td><td class="t">22:13:27.000</td><td>command</td><td>uid 8</td><td>set fan 3, refused: there is no output fan</td></tr>
<tr><td class="r">7</td><td class="t">22:13:28.000</td><td>state</td><td>door</td><td>shut -&gt; open (somebody)</td></tr>
</table>

)");
    for (const char* const kind : {"note", "command", "alarm", "state"})
      CHECK(has(all.page, "<path class=\"" + std::string(kind) + "\" d=\"M"));
    CHECK(has(all.page, "<span class=\"range\">limits: low -1000, high 50</span>"));
    CHECK(times_in(all.page, "<path class=\"warn\"") == 1);  // the other is far away
    CHECK(times_in(all.page, "<figure>") == 2);              // and none of the course itself
    CHECK(has(all.page, "of its values"));
    // A reload brought another limit, and later one that left it as it was: each is drawn for its time.
    const std::string added =
        "INSERT INTO rtdata_configuration (run, time, object, text, count) SELECT run, started + 6000000000, '', "
        "replace(configuration, '50', '40'), 1 FROM rtdata_run;"
        "INSERT INTO rtdata_configuration (run, time, object, text, count) SELECT run, started + 7000000000, '', "
        "replace(configuration, '50', '40'), 1 FROM rtdata_run;";
    written_as(path, added);
    const Made reloaded = made(path);
    CHECK_PAGE(reloaded);
    CHECK(has(reloaded.page,
              "<span class=\"range\">limits: low -1000, high 50 until 22:13:26.000, low -1000, high 40 from "
              "22:13:26.000</span>"));
    const auto shade_of = [&](std::size_t number) {
      std::size_t at = 0;
      for (std::size_t i = 0; i <= number; ++i) at = reloaded.page.find("<rect class=\"warn\"", at + 1);
      REQUIRE(at != std::string::npos);
      return reloaded.page.substr(at, reloaded.page.find("/>", at) - at);
    };
    CHECK(times_in(reloaded.page, "<path class=\"warn\"") == 2);
    const std::string first = shade_of(0), second = shade_of(1);
    CHECK(has(first, "x=\"0\""));
    const std::size_t width_at = first.find("width=\"") + 7;
    const std::string width = first.substr(width_at, first.find('"', width_at) - width_at);
    CHECK(has(second, "x=\"" + width + "\""));  // it begins where the other ends
  }

  TEST_CASE("FW-5 report: markup, quotes, long texts and bytes that are no text, in each place") {
    const Folder folder;
    const std::string path = make(folder, {}, "a b'\"<i>.db");
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      Feed<app::CommandRecord> commands(loop, {.name = "rtdata-commands", .topic = app::command_topic});
      commands.publish({"note <script>alert(1)</script> \"Grüße\" & 'more' \xff\xfe", "<b>", true, "noted"});
      loop.advance(1s);
      loop.close();
    }
    const std::string odd = "'<script src=\"http://evil\">' || char(10) || '\"''&Ü' || CAST(x'ff1b' AS TEXT)";
    std::string statements;
    for (const char* const column : {"name", "notes", "program", "host", "remark", "configuration"})
      statements += "UPDATE rtdata_run SET " + std::string(column) + " = " + odd + " || hex(zeroblob(2048));";
    statements += "UPDATE rtdata_gap SET reason = " + odd + ";";
    statements += "INSERT INTO rtdata_error SELECT 1, started, " + odd + ", " + odd + ", " + odd +
                  ", 3, started FROM rtdata_run WHERE run = 1;";
    statements += "INSERT INTO rtdata_health SELECT 1, started, " + odd + ", " + odd + ", " + odd + ", " + odd +
                  ", 1, started FROM rtdata_run WHERE run = 1;";
    statements += "INSERT INTO rtdata_configuration SELECT 1, started, " + odd + ", " + odd +
                  ", 1 FROM rtdata_run WHERE run = 1;";
    written_as(path, statements);
    for (const std::int64_t run : {1, 2}) {
      const Made all = made(path, std::to_string(run));
      std::string page = all.page;
      for (std::size_t at; (at = page.find("http://evil")) != std::string::npos;) page.erase(at, 7);
      CHECK(all.status == 0);
      CHECK(mistakes_in(page) == "");
      CHECK(has(page, "&lt;script src=&quot;evil&quot;&gt;"));
      CHECK(has(page, "Ü"));
      CHECK_FALSE(has(page, "\x1b"));
      CHECK_FALSE(has(page, "\xff"));
      CHECK(has(page, "<code>rtdata verify &#39;a b&#39;\\&#39;&#39;&quot;&lt;i&gt;.db&#39; --run"));
    }
    CHECK(has(made(path, "2").page,
              "<td>&lt;b&gt;</td><td>&lt;script&gt;alert(1)&lt;/script&gt; &quot;Grüße&quot; &amp; "
              "&#39;more&#39; ?\?</td>"));
  }

  TEST_CASE("FW-5 report: numbers that are none, infinite, or all alike") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      Feed<Odd> feed(loop, {.name = "odd"});
      constexpr double none = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
      for (const double value : {1.0, none, inf, -inf, 1e308, -1e308}) {
        feed.publish({value, std::nullopt});
        loop.advance(1s);
      }
      loop.close();
    }
    const Made all = made(path);
    CHECK_PAGE(all);
    CHECK(has(all.page, "least -inf at 22:13:23.0"));
    CHECK(has(all.page, "most inf at 22:13:22.0"));
    CHECK(has(all.page, "over 83.3 % of its values; 1 is absent or NaN; some are infinite</span>"));
    CHECK(has(all.page,
              "<b>odd.maybe</b></span><span class=\"there\">all there</span><span class=\"range\">no values; 6 are "
              "absent or NaN</span>"));
    CHECK_FALSE(has(all.page, "nan"));
  }

  TEST_CASE("FW-5 report: of a run without rows, of one that is not there, of what is no recording") {
    const Folder folder;
    const std::string path = folder / "run.db";
    for (int i = 0; i < 2; ++i) {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      loop.advance(1s);
      loop.close();
    }
    const Made empty = made(path);
    CHECK_PAGE(empty);
    CHECK(has(empty.page, "<p>The run has no numbers.</p>"));
    CHECK(has(empty.page, "Run 2 of run.db"));
    CHECK(has(made(path, "1").page, "Run 1 of run.db"));
    const Made missing = made(path, "7");
    CHECK(missing.status == 1);
    CHECK(missing.page == "");
    CHECK(has(missing.err, "there is no run 7; its runs are 1, 2"));
    CHECK(made(folder / "none.db").status == 2);
    std::ofstream(folder / "text.db") << "no recording at all, but long enough to be taken for one, if nobody looks";
    CHECK(made(folder / "text.db").status == 2);
    // Pages of the file are overwritten.
    const std::string damaged = make(folder, {}, "damaged.db");
    {
      const auto size = std::filesystem::file_size(damaged);
      std::fstream file(damaged, std::ios::in | std::ios::out | std::ios::binary);
      file.seekp(static_cast<std::streamoff>(size / 2));
      file << std::string(size / 4, '\x55');
    }
    const Made broken = made(damaged);
    CHECK(broken.status == 2);
    CHECK(broken.page == "");
    CHECK(has(broken.err, "damaged"));
  }

  TEST_CASE("FW-5 report: a value that was changed is in the verdict, and in the checksum") {
    const Folder folder;
    const std::string path = make(folder);
    const std::string before = verified(path).runs.at(0).checksum_text();
    sql(path, "UPDATE \"room/climate\" SET temperature = 3 WHERE sequence = 7");
    const Made all = made(path);
    CHECK_PAGE(all);
    CHECK(has(all.page, "<div class=\"verdict bad\">"));
    CHECK(has(all.page, "  not balanced\n"));
    CHECK(has(all.page, "a value was changed"));
    CHECK_FALSE(has(all.page, before));
  }

  TEST_CASE("FW-5 report: while it is recorded, after a kill, and of a pruned recording") {
    const Folder folder;
    const std::string path = folder / "run.db", copy = folder / "copy.db", pruned = folder / "pruned.db";
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Feed<Climate> feed(loop, {.name = "a", .topic = "t"});
      for (int i = 0; i < 30; ++i) {
        feed.publish({1.0 * i, 0});
        loop.advance(100ms);
      }
      const Made shown = made(path);
      CHECK_PAGE(shown);
      CHECK(has(shown.page, "all there so far"));
      CHECK(has(shown.page, "recording: its rows agree with the last account; verify it again when it is\n"));
      sql(path, "VACUUM INTO '" + copy + "'");
      CHECK(loop.close() == 0);
    }
    sql(copy, "UPDATE rtdata_run SET pid = 0");
    write_checksums(copy);
    const Made killed = made(copy);
    CHECK_PAGE(killed);
    CHECK(has(killed.page, "not sealed"));
    CHECK(has(killed.page, "<div class=\"verdict bad\">"));
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = pruned, .max_age = 10min});
      Sensor<Climate> room(loop, {.name = "room", .rate = 10_Hz}, [&]() -> Result<Climate> { return Climate{20, 50}; });
      loop.advance(30min);
      room.close();
      CHECK(loop.close() == 0);
    }
    const Made rest = made(pruned);
    CHECK_PAGE(rest);
    const auto stored = static_cast<double>(number(pruned, "SELECT stored FROM rtdata_ledger"));
    const auto there = static_cast<double>(number(pruned, "SELECT count(*) FROM room"));
    REQUIRE(there < stored);
    // A step whose first rows are pruned has the figures of all of them.
    CHECK(has(rest.page, "always 20 over 3"));
    CHECK_FALSE(has(rest.page, "over all of the time"));
    // Nobody takes the rest for all.
    const std::string deleted = std::to_string(static_cast<std::uint64_t>(stored - there));
    CHECK(has(rest.page, "<span class=\"there\">nothing lost, " + deleted + " pruned</span>"));
    CHECK(has(section(rest.page, "What is missing"), "by max_age or max_bytes: room " + deleted + "</p>"));
    CHECK_FALSE(has(rest.page, "Nothing."));
    std::ostringstream out, err;
    CHECK(app::plot({.database = pruned, .fields = {"room.temperature"}}, out, err) == 0);
    CHECK(has(out.str(), "nothing lost, " + deleted + " pruned\n"));
    std::ostringstream compared;
    CHECK(app::compare({.database = pruned, .first = "1", .second = "1"}, compared, err) == 0);
    CHECK(has(compared.str(), "\n  2: " + deleted + " rows of the run are pruned, and not in the figures\n"));
  }

  TEST_CASE("FW-5 report: the mean of rows that do not stand for equal times is called so") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      double value = 0;
      Sensor<Climate> held(
          loop, {.name = "held", .rate = 10_Hz, .process = {{"temperature", {.filters = {Filter::delta(1)}}}}},
          [&]() -> Result<Climate> {
            return Climate{value, 1};
          });
      Sensor<Climate> faster(loop, {.name = "faster", .rate = 1_Hz}, [&]() -> Result<Climate> {
        return Climate{value, 1};
      });
      loop.advance(9950ms);
      value = 7;
      faster.set_rate(10_Hz);
      loop.advance(1s);
      loop.close();
    }
    const Made all = made(path);
    CHECK_PAGE(all);
    CHECK(number(path, "SELECT count(*) FROM held") == 2);
    const std::string held_back = std::to_string(
        number(path, "SELECT filtered FROM rtdata_ledger WHERE topic = 'held'"));
    CHECK(has(all.page, ", mean 3.5 of the recorded values; " + held_back + " samples were held back</span>"));
    CHECK(has(all.page, "always 1 in the recorded values; " + held_back + " samples were held back</span>"));
    CHECK(has(all.page, "<span class=\"there\">all there, " + held_back + " held back</span>"));
    CHECK(has(all.page, " of the recorded values; the rate was changed</span>"));
    CHECK_FALSE(has(all.page, "over all of the time"));
  }

  TEST_CASE("FW-5 report: how far UTC may be wrong is said where the clock said how well it was set") {
    const Folder folder;
    const std::string path = make(folder);
    CHECK(has(made(path).page, "The time of day was read 2 times (system 2). How far UTC is wrong is not known"));
    // 1 ms at both ends, and 1 us more for each second from the nearer one: 5 s.
    sql(path, "UPDATE rtdata_clock SET accuracy = 1000000, occasion = 'step'");
    const std::string page = made(path).page;
    CHECK(has(page, "UTC is right to within 1.1 ms in all of the run. The clock was set 2 times;"));
    // The better one is 10 s away from the other end.
    sql(path, "UPDATE rtdata_clock SET accuracy = 20000000 WHERE occasion = 'step' AND rowid = 1");
    sql(path, "UPDATE rtdata_clock SET accuracy = 500000 WHERE rowid = 2");
    CHECK(has(made(path).page, "UTC is right to within 520 us in all of the run."));
  }

  TEST_CASE("FW-5 report: a mean is of all of the time only if nothing is missing") {
    app::Curve curve;
    curve.steps.push_back({Time{}, 900, 900, 1.0, 2.0, 1.5});
    LedgerEntry account;
    account.stored = 900;
    CHECK(app::coverage_of(curve, account, 0s, 100s) == 1);
    CHECK(app::coverage_of(curve, account, 25s, 100s) == 0.75);
    account.sensor.has_schedule = true;
    account.sensor.scheduled = 1000;
    account.sensor.missed = 60;
    account.sensor.failed = 40;
    CHECK(app::coverage_of(curve, account, 0s, 100s) == 0.9);
    account.sensor.missed = account.sensor.failed = 0;
    account.dropped_newest = 100;
    CHECK(app::coverage_of(curve, account, 0s, 100s) == 0.9);
    account.dropped_newest = 0;
    account.stored = 1800;  // half of them pruned
    CHECK(app::coverage_of(curve, account, 0s, 100s) == 0.5);
    account.stored = 900;
    curve.steps[0].numbers = 450;  // NaN
    CHECK(app::coverage_of(curve, account, 0s, 100s) == 0.5);
    CHECK(app::coverage_of(app::Curve{}, LedgerEntry{}, 0s, 100s) == 0);
    // A tick that failed because its sample was unreadable is missing once.
    curve.steps[0].events = curve.steps[0].numbers = account.stored = 600;
    account.sensor.failed = account.sensor.unreadable = 400;
    CHECK(app::coverage_of(curve, account, 0s, 100s) == 0.6);
    // What a filter held back was there.
    curve.steps[0].events = curve.steps[0].numbers = 26;
    LedgerEntry lines;
    lines.stored = 26;
    lines.sensor.filtered = 449;
    lines.sensor.unreadable = 25;
    CHECK(app::coverage_of(curve, lines, 0s, 100s) == 0.95);
  }

  TEST_CASE("FW-5 report: 500 topics, and a day of 20 fields from its steps, are pages that can be sent") {
    const Folder folder;
    const std::string many = folder / "many.db", day = folder / "day.db";
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = many});
      std::vector<Feed<Numbers>> feeds;
      for (int i = 0; i < 500; ++i) feeds.emplace_back(loop, FeedConfig{.name = "s" + std::to_string(i)});
      for (int i = 0; i < 20; ++i) {
        for (auto& feed : feeds) feed.publish({.a = 1.0 * i, .b = std::sin(i)});
        loop.advance(1s);
      }
      loop.close();
    }
    const Made pages = made(many);
    CHECK_PAGE(pages);
    CHECK(times_in(pages.page, "<figure>") == 1000);
    CHECK(has(pages.page, "4000 left out; `rtdata plot` draws each."));
    CHECK(has(pages.page, "200 left out; `rtdata info` has all."));
    CHECK(has(pages.page, "450 left out of these."));
    CHECK(pages.page.size() < 6'000'000);
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = day});
      Feed<Numbers> one(loop, {.name = "one"}), two(loop, {.name = "two"});
      for (int i = 0; i < 24 * 3600; ++i) {
        const double x = i / 600.0;
        const Numbers numbers{x, std::sin(x), std::cos(x), i % 17 * 1.0, i % 101 * 0.1, std::sin(x * x),
                              1, 2,           -x,          1 / (1 + x)};
        one.publish(numbers);
        two.publish(numbers);
        loop.advance(1s);
      }
      loop.close();
    }
    const Made long_run = made(day);
    CHECK_PAGE(long_run);
    CHECK(times_in(long_run.page, "<figure>") == 20);
    CHECK(has(long_run.page, "A line shows the mean of each 2 min"));
    CHECK(has(long_run.page, "least 0 at 22:13:00, most 144 at 2023-11-15 22:13:00, mean "));
    CHECK(has(long_run.page, "are the beginning of the minute."));
    CHECK(long_run.page.size() < 3'000'000);
    CHECK(long_run.page.size() > 100'000);
  }

  TEST_CASE("FW-5 report: its file is new, or is to be replaced; a full disk is told, and no part of a page is left") {
    const rtdata::test::Folder folder;
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = folder.path() + "/run.db"});
      Feed<Climate> feed(loop, {.name = "a"});
      for (int i = 0; i < 20; ++i) {
        feed.publish({1.0 * i, 0});
        loop.advance(100ms);
      }
      loop.close();
    }
    using rtdata::test::Process;
    const auto ran = [&](std::vector<std::string> arguments) {
      arguments.insert(arguments.begin(), {"report", "run.db"});
      Process process(folder, rtdata::test::program, arguments);
      const int status = process.end();
      return Made{status, process.out, process.err};
    };
    const auto first = ran({});
    CHECK(first.err == "");
    CHECK(first.page.starts_with("run.html ("));
    CHECK(
        first.page.ends_with("): run 1, balanced\n  nothing lost: 20 rows\n"
                             "  not detectable: losses in the sources of a, which do not number their "
                             "samples\n"));
    const std::string page = folder.read("run.html");
    CHECK(mistakes_in(page) == "");
    folder.write("run.html", "mine");
    const auto of_none = ran({"--run", "7"});
    CHECK(has(of_none.err, "there is no run 7"));
    CHECK_FALSE(has(of_none.err, "run.html"));
    const auto second = ran({});
    CHECK(second.status == 1);
    CHECK(second.page == "");
    CHECK(has(second.err, "cannot write the report: run.html: the file exists"));
    CHECK(folder.read("run.html") == "mine");
    const std::string recording = folder.read("run.db");
    const auto slip = ran({"-o", "run.db", "--overwrite"});
    CHECK(slip.status == 1);
    CHECK(has(slip.err, "this file is a recording"));
    CHECK(folder.read("run.db") == recording);
    CHECK(ran({"--overwrite"}).status == 0);
    CHECK(folder.read("run.html").size() == page.size());
    const auto stream = ran({"-o", "-"});
    CHECK(stream.status == 0);
    CHECK(stream.page.size() == page.size());
    const auto full = ran({"-o", "/dev/full", "--overwrite"});
    CHECK(full.status == 1);
    CHECK(has(full.err, "cannot write the report: /dev/full"));
    const auto nowhere = ran({"-o", "no/such/folder.html"});
    CHECK(nowhere.status == 1);
    CHECK(has(nowhere.err, "cannot write the report: no/such/folder.html"));
    // A page of more than a file may have, in the middle of which the writing fails.
    sql(folder.path() + "/run.db", "UPDATE rtdata_run SET configuration = hex(zeroblob(40000))");
    Process limited(folder, "/bin/sh",
                    {"-c", "ulimit -f 80; trap '' XFSZ; exec \"$0\" report run.db -o cut.html", rtdata::test::program});
    CHECK(limited.end() == 1);
    CHECK(has(limited.err, "cannot write the report: cut.html"));
    CHECK_FALSE(folder.has("cut.html"));
    // Neither does an export leave a part of a file.
    sql(folder.path() + "/run.db", "UPDATE rtdata_topic SET table_name = 'long' WHERE topic = 'a'");
    sql(folder.path() + "/run.db",
        "CREATE TABLE long AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 9999) SELECT "
        "a.*, i FROM a, n WHERE a.sequence = 1");
    Process exported(
        folder, "/bin/sh",
        {"-c", "ulimit -f 80; trap '' XFSZ; exec \"$0\" export run.db --folder out", rtdata::test::program});
    CHECK(exported.end() == 1);
    CHECK(has(exported.err, "cannot write the export: out/a.csv"));
    CHECK_FALSE(folder.has("out/a.csv"));
  }
}
