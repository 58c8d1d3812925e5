#include "rtdata/data/time.hpp"

#include <doctest/doctest.h>

#include <cmath>

#include <limits>

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE("data") {
  TEST_CASE("US-34 timestamps convert, compare, add and subtract in ns, us, ms and s") {
    const Time t = from_nanoseconds(1'772'366'400'123'456'789);
    CHECK(to_nanoseconds(t) == 1'772'366'400'123'456'789);
    CHECK(std::chrono::duration_cast<std::chrono::microseconds>(t.time_since_epoch()).count() == 1'772'366'400'123'456);
    CHECK(std::chrono::duration_cast<std::chrono::milliseconds>(t.time_since_epoch()).count() == 1'772'366'400'123);
    CHECK(std::chrono::duration_cast<std::chrono::seconds>(t.time_since_epoch()).count() == 1'772'366'400);
    CHECK(t + 1ns > t);
    CHECK(t - 1s < t);
    CHECK((t + 1500us) - t == Duration(1'500'000));
    CHECK(t + 1h - 60min == t);
    CHECK(wall_clock_now() > from_nanoseconds(1'700'000'000'000'000'000));
  }

  TEST_CASE("US-34 a time is written in ISO 8601 with nine decimals and read back equal") {
    CHECK(to_iso8601(from_nanoseconds(0)) == "1970-01-01T00:00:00.000000000Z");
    CHECK(to_iso8601(from_nanoseconds(-1)) == "1969-12-31T23:59:59.999999999Z");
    CHECK(to_iso8601(from_nanoseconds(1'772'366'400'123'456'789)) == "2026-03-01T12:00:00.123456789Z");
    for (const std::int64_t ns :
         {std::int64_t{0}, std::int64_t{-1}, std::int64_t{951782400000000000}, std::int64_t{-2208988800000000001},
          std::numeric_limits<std::int64_t>::max(), std::numeric_limits<std::int64_t>::min()}) {
      CAPTURE(ns);
      CHECK(to_nanoseconds(parse_iso8601(to_iso8601(from_nanoseconds(ns))).or_throw()) == ns);
    }
    const Time noon = parse_iso8601("2026-03-01T12:00:00Z").or_throw();
    CHECK(parse_iso8601("2026-03-01T14:00:00+02:00").or_throw() == noon);
    CHECK(parse_iso8601("2026-03-01 07:30:00-0430").or_throw() == noon);
    CHECK(parse_iso8601("2026-03-01T12:00:00.5z").or_throw() == noon + 500ms);
    CHECK(parse_iso8601("2026-03-01 12:00Z").or_throw() == noon);
    CHECK(parse_iso8601("2026-03-01T14:00+02:00").or_throw() == noon);
    CHECK(parse_iso8601("2024-02-29T00:00:00Z"));
  }

  TEST_CASE("wrong times are refused") {
    for (const char* text : {"",
                             "now",
                             "2026-03-01",
                             "2026-03-01T12:00:00",
                             "2026-3-1T12:00:00Z",
                             "2026-13-01T12:00:00Z",
                             "2026-00-01T12:00:00Z",
                             "2026-02-29T12:00:00Z",
                             "2026-04-31T12:00:00Z",
                             "2026-03-01T24:00:00Z",
                             "2026-03-01T12:60:00Z",
                             "2026-03-01T12:00:60Z",
                             "2026-03-01T12:00:00.Z",
                             "2026-03-01T12:00.5Z",
                             "2026-03-01T12:00",
                             "2026-03-01T12:00:Z",
                             "2026-03-01T12Z",
                             "2026-03-01T12:00:00.1234567890Z",
                             "2026-03-01T12:00:00Zx",
                             "2026-03-01T12:00:00+25:00",
                             "2026-03-01T12:00:00+2",
                             "1677-09-21T00:12:43.145224191Z",
                             "2262-04-11T23:47:16.854775808Z",
                             "0000-01-01T00:00:00Z",
                             "9999-12-31T23:59:59Z"}) {
      CAPTURE(text);
      const auto result = parse_iso8601(text);
      CHECK_FALSE(result);
      if (!result) CHECK(result.error().advice.find("2026") != std::string::npos);
    }
  }

  TEST_CASE("US-43 a duration is read exactly") {
    CHECK(parse_duration("10 ms").or_throw() == 10ms);
    CHECK(parse_duration("1.5s").or_throw() == 1500ms);
    CHECK(parse_duration("250us").or_throw() == 250us);
    CHECK(parse_duration("250\u00b5s").or_throw() == 250us);
    CHECK(parse_duration(" 2 min ").or_throw() == 120s);
    CHECK(parse_duration("1 h").or_throw() == 3600s);
    CHECK(parse_duration("3 d").or_throw() == 72h);
    CHECK(parse_duration("0 s").or_throw() == 0s);
    CHECK(parse_duration("0.1 s").or_throw() == 100ms);
    CHECK(parse_duration("0.000000001 s").or_throw() == 1ns);
    CHECK(parse_duration("0.123456789 s").or_throw() == 123456789ns);
    CHECK(parse_duration("0.25000000000000000000000 min").or_throw() == 15s);
    CHECK(parse_duration("9223372036854775807 ns").or_throw().count() == std::numeric_limits<std::int64_t>::max());
    CHECK(parse_duration("9223372036.854775807 s").or_throw().count() == std::numeric_limits<std::int64_t>::max());
  }

  TEST_CASE("wrong durations are refused with advice") {
    CHECK(parse_duration("10").error().advice == "write a unit, such as \"10 s\" or \"10 ms\"");
    CHECK(parse_duration("1,5 s").error().why == "its decimals come after a comma");
    CHECK(parse_duration("1,5 s").error().advice == "write a point, such as 2.5");
    for (const char* text :
         {"", " ", "ms", "abc", "-1 s", "1. s", ".5 s", "1 sec", "1 S", "1e3 s", "0.1 ns", "1.0000000001 s",
          "9223372036854775808 ns", "300000 d", "99999999999999999999999 s", "1 s 2", "1,5 s", "nan s"}) {
      CAPTURE(text);
      const auto result = parse_duration(text);
      CHECK_FALSE(result);
      if (!result) CHECK_FALSE(result.error().advice.empty());
    }
  }

  TEST_CASE("a duration is written so that it reads back equal") {
    CHECK(to_string(Duration(10ms)) == "10 ms");
    CHECK(to_string(Duration(1500ms)) == "1.5 s");
    CHECK(to_string(Duration(0)) == "0 s");
    CHECK(to_string(Duration(90s)) == "90 s");
    CHECK(to_string(Duration(2min)) == "2 min");
    CHECK(to_string(Duration(1234567ns)) == "1.234567 ms");
    CHECK(to_string(Duration(-10ms)) == "-10 ms");
    CHECK(to_string(Duration::min()) == "-9223372036.854775808 s");
    for (const std::int64_t ns : {1LL, 999LL, 1001LL, 123456789LL, 86400000000000LL, 9223372036854775807LL}) {
      CHECK(parse_duration(to_string(Duration(ns))).or_throw().count() == ns);
    }
  }

  TEST_CASE("US-5 a rate is read exactly, as a frequency or a period") {
    CHECK(parse_rate("100 Hz").or_throw().period() == 10ms);
    CHECK(parse_rate("0.1 Hz").or_throw().period() == 10s);
    CHECK(parse_rate("2.5 kHz").or_throw().period() == 400us);
    CHECK(parse_rate("1 MHz").or_throw().period() == 1us);
    CHECK(parse_rate("1 GHz").or_throw().period() == 1ns);
    CHECK(parse_rate("6 /min").or_throw().period() == 10s);
    CHECK(parse_rate("1 /h").or_throw().period() == 3600s);
    CHECK(parse_rate("10 ms").or_throw().period() == 10ms);
    CHECK(parse_rate("3 Hz").or_throw().period() == 333333333ns);
    CHECK(parse_rate("0.0000001 Hz").or_throw().period() == 10000000s);
    CHECK(100_Hz == parse_rate("100 Hz").or_throw());
  }

  TEST_CASE("wrong rates are refused with advice") {
    CHECK(parse_rate("10").error().advice == "write a unit, such as \"10 Hz\"");
    CHECK(parse_rate("2,5 Hz").error().why == "its decimals come after a comma");
    CHECK(parse_rate("every 2,5 s").error().why == "its decimals come after a comma");
    for (const char* text : {"", "Hz", "-1 Hz", "0 Hz", "0 ms", "1 hz", "1 bpm", "3 GHz", "0.00000000001 mHz",
                             "1234567890123456789 Hz", "1.2345678901234567890 Hz", "every 5 Hz", "every"}) {
      CAPTURE(text);
      const auto result = parse_rate(text);
      CHECK_FALSE(result);
      if (!result) CHECK_FALSE(result.error().advice.empty());
    }
  }

  TEST_CASE("a rate is written so that it reads back equal") {
    CHECK(to_string(100_Hz) == "100 Hz");
    CHECK(to_string(Rate::from_period(10s)) == "0.1 Hz");
    CHECK(to_string(2_kHz) == "2 kHz");
    CHECK(to_string(Rate::from_period(16700us)) == "every 16.7 ms");
    CHECK(to_string(Rate{}) == "no rate");
    for (const std::int64_t ns : {1LL, 3LL, 1000LL, 333333333LL, 16666667LL, 60000000000LL, 86400000000001LL}) {
      const Rate rate = Rate::from_period(Duration(ns));
      CAPTURE(to_string(rate));
      CHECK(parse_rate(to_string(rate)).or_throw() == rate);
    }
  }

  TEST_CASE("a rate that no number of ns can say is none, or the slowest") {
    const double infinite = std::numeric_limits<double>::infinity();
    for (const double none :
         {0.0, -0.0, -1.0, -infinite, std::numeric_limits<double>::quiet_NaN(), infinite, 1e300, 3e9})
      CHECK(!Rate::hertz(none));
    for (const double slow : {std::numeric_limits<double>::denorm_min(), 1e-300, 1e-10})
      CHECK(Rate::hertz(slow).period() == Duration::max());
    CHECK(Rate::hertz(1e9).period() == Duration{1});
    CHECK(Rate::hertz(2e-10).period() == Duration{5'000'000'000'000'000'000});
    for (const Duration none : {Duration{0}, Duration{-1}, Duration::min()}) {
      CHECK(!Rate::from_period(none));
      CHECK(to_string(Rate::from_period(none)) == "no rate");
      CHECK(std::isfinite(Rate::from_period(none).hertz()));
    }
    const Rate slowest = Rate::from_period(Duration::max());
    const auto read = parse_rate(to_string(slowest));
    REQUIRE(read);
    CHECK(*read == slowest);
    for (const char* text : {"nan Hz", "inf Hz", "0 Hz", "-1 Hz", "1e400 Hz", "0.000000000000000001 mHz", "99 GHz"})
      CHECK(!parse_rate(text));
  }
}
