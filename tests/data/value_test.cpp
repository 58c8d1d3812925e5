#include "rtdata/data/value.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "data/payloads.hpp"

using namespace rtdata;
using namespace payloads;

namespace {

struct Access {
  Everything data;
  std::byte* bytes() { return reinterpret_cast<std::byte*>(&data); }
  const Leaf& leaf(std::string_view path) {
    const Leaf* leaf = description_of<Everything>()->find(path);
    REQUIRE(leaf != nullptr);
    return *leaf;
  }
  Value get(std::string_view path) { return read(leaf(path), bytes()); }
  Result<void> set(std::string_view path, const Value& value) { return write(leaf(path), bytes(), value); }
  Errc refused(std::string_view path, const Value& value) {
    const Everything before = data;
    const auto result = set(path, value);
    CHECK(data == before);
    if (result) return Errc::ok;
    CHECK(result.error().where.find(path) != std::string::npos);
    return static_cast<Errc>(result.error().code.value());
  }
};

}  // namespace

TEST_SUITE("data") {
  TEST_CASE("US-24 every kind of value is read and written through its description") {
    Access a;
    CHECK(a.set("flag", true));
    CHECK(a.set("letter", 'z'));
    CHECK(a.set("i8", std::int64_t{-128}));
    CHECK(a.set("i64", std::numeric_limits<std::int64_t>::min()));
    CHECK(a.set("u64", std::numeric_limits<std::uint64_t>::max()));
    CHECK(a.set("u8", 255.0));
    CHECK(a.set("f32", static_cast<double>(0.1F)));
    CHECK(a.set("f64", std::int64_t{1} << 53));
    CHECK(a.set("name", std::string("seven77")));
    CHECK(a.set("state", std::string("broken")));
    CHECK(a.set("maybe", 2.5));
    CHECK(a.set("maybe_name", std::string("abc")));
    CHECK(a.set("maybe_state", std::int64_t{1}));
    CHECK(a.set("numbers[2]", 3.0));
    CHECK(a.set("maybes[1]", std::int64_t{9}));
    CHECK(a.set("points[1].x", -1.0));
    CHECK(a.data.flag);
    CHECK(a.data.letter == 'z');
    CHECK(a.data.i8 == -128);
    CHECK(a.data.u8 == 255);
    CHECK(a.data.u64 == std::numeric_limits<std::uint64_t>::max());
    CHECK(a.data.f32 == 0.1F);
    CHECK(a.data.name == "seven77");
    CHECK(a.data.state == State::broken);
    CHECK(a.data.maybe == 2.5);
    CHECK(*a.data.maybe_name == "abc");
    CHECK(a.data.maybe_state == State::running);
    CHECK(a.data.numbers[2] == 3.0F);
    CHECK(a.data.maybes[1] == 9U);
    CHECK_FALSE(a.data.maybes[0].has_value());
    CHECK(a.data.points[1].x == -1.0);
    CHECK(a.get("flag") == Value(true));
    CHECK(a.get("u64") == Value(std::numeric_limits<std::uint64_t>::max()));
    CHECK(a.get("f32") == Value(static_cast<double>(0.1F)));
    CHECK(a.get("state") == Value(std::string("broken")));
    CHECK(a.get("maybes[0]") == Value());
    CHECK(a.set("maybe", Value()));
    CHECK(a.get("maybe") == Value());
    CHECK(a.set("f64", std::numeric_limits<double>::quiet_NaN()));
    CHECK(std::isnan(a.data.f64));
    CHECK(a.set("f32", std::numeric_limits<double>::infinity()));
    a.data.state = static_cast<State>(99);
    CHECK(a.get("state") == Value(std::int64_t{99}));
  }

  TEST_CASE("a value that its field cannot take is refused, never narrowed") {
    Access a;
    CHECK(a.refused("u8", std::int64_t{300}) == Errc::out_of_range);
    CHECK(a.refused("u8", std::int64_t{-1}) == Errc::out_of_range);
    CHECK(a.refused("i8", std::int64_t{128}) == Errc::out_of_range);
    CHECK(a.refused("i32", 3.7) == Errc::out_of_range);
    CHECK(a.refused("i32", 1e10) == Errc::out_of_range);
    CHECK(a.refused("i32", std::numeric_limits<double>::quiet_NaN()) == Errc::out_of_range);
    CHECK(a.refused("i64", 9223372036854775808.0) == Errc::out_of_range);
    CHECK(a.refused("i64", std::uint64_t{1} << 63) == Errc::out_of_range);
    CHECK(a.refused("u64", 18446744073709551616.0) == Errc::out_of_range);
    CHECK(a.refused("u64", -0.5) == Errc::out_of_range);
    CHECK(a.refused("i32", true) == Errc::bad_argument);
    CHECK(a.refused("flag", std::int64_t{1}) == Errc::bad_argument);
    CHECK(a.refused("f64", std::string("1")) == Errc::bad_argument);
    CHECK(a.refused("f64", (std::int64_t{1} << 53) + 1) == Errc::out_of_range);
    CHECK(a.refused("f64", std::numeric_limits<std::int64_t>::max()) == Errc::out_of_range);
    CHECK(a.refused("f64", std::numeric_limits<std::uint64_t>::max()) == Errc::out_of_range);
    CHECK(a.refused("f32", std::int64_t{16777217}) == Errc::out_of_range);
    CHECK(a.refused("f32", 1e300) == Errc::out_of_range);
    CHECK(a.refused("f32", 3.4028235677973366e38) == Errc::out_of_range);
    CHECK(a.refused("name", std::string("eight888")) == Errc::does_not_fit);
    CHECK(a.refused("letter", std::string("ab")) == Errc::out_of_range);
    CHECK(a.refused("state", std::string("brokn")) == Errc::bad_argument);
    CHECK(a.refused("state", std::int64_t{40000}) == Errc::out_of_range);
    CHECK(a.refused("f64", Value()) == Errc::bad_argument);
    CHECK(a.refused("maybe", std::string("x")) == Errc::bad_argument);
    CHECK(a.set("state", std::string("brokn")).error().advice == "did you mean broken?");
  }
}
