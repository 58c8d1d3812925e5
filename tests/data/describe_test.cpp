#include "rtdata/data/describe.hpp"

#include <doctest/doctest.h>

#include <cstring>
#include <limits>

#include "data/payloads.hpp"
#include "rtdata/data/event.hpp"

using namespace rtdata;
using namespace payloads;

namespace {

static_assert(Described<Climate> && Described<Everything> && Described<Nothing> && !Described<int> &&
              !Described<std::string>);
static_assert(DescribedEnum<State> && !DescribedEnum<Kind>);
static_assert(detail::has_more_members_than<Everything, 0>());

struct Base {
  int a = 0;
  std::optional<double> b;
};
struct Derived : Base {
  double c = 0;
  RTDATA_FIELDS(Derived, (a), (b), (c))
};
struct WithConstructor {
  explicit WithConstructor(double v) : value(v) {}
  double value;
  RTDATA_FIELDS(WithConstructor, (value, "V"))
};

DescriptionBuilder everything_by_hand() {
  const std::vector<EnumValue> states{{"idle", 0}, {"running", 1}, {"broken", -7}};
  const auto point = DescriptionBuilder("Point").field("x", Kind::f64, "m").field("label", Kind::i8).build().or_throw();
  using P = DescriptionBuilder::Presence;
  auto builder = DescriptionBuilder("everything");
  builder.field("flag", Kind::boolean).field("letter", Kind::character);
  builder.field("i8", Kind::i8).field("i16", Kind::i16).field("i32", Kind::i32).field("i64", Kind::i64);
  builder.field("u8", Kind::u8).field("u16", Kind::u16).field("u32", Kind::u32).field("u64", Kind::u64);
  builder.field("f32", Kind::f32, "V").field("f64", Kind::f64, "Cel").text("name", 7);
  builder.enumeration("state", states, Kind::i16);
  builder.field("maybe", Kind::f64, "K", P::optional).text("maybe_name", 5, P::optional);
  builder.enumeration("maybe_state", states, Kind::i16, P::optional).field("maybe_flag", Kind::boolean, "", P::optional);
  builder.array("numbers", Kind::f32, 3, "m/s2")
      .text_array("names", 3, 2)
      .enumeration_array("states", states, 2, Kind::i16);
  builder.array("maybes", Kind::u32, 2, "", P::optional)
      .record("origin_point", *point)
      .record_array("points", *point, 2);
  return builder;
}

}  // namespace

TEST_SUITE("data") {
  TEST_CASE("US-24 a description says name, kind, unit and place of every field") {
    const Description& d = *description_of<Climate>();
    CHECK(d.name() == "climate");
    REQUIRE(d.leaves().size() == 2);
    CHECK(d.leaves()[1].path == "humidity");
    CHECK(d.leaves()[1].unit == "%RH");
    CHECK(d.leaves()[1].kind == Kind::f64);
    CHECK(d.leaves()[1].offset == sizeof(double));
    CHECK(d.size() == sizeof(Climate));
    CHECK(&d == description_of<Climate>().get());
    CHECK(d.find("humidity") == &d.leaves()[1]);
    CHECK(d.find("pressure") == nullptr);
  }

  TEST_CASE("US-23 an event without data has a description without fields") {
    const Description& d = *description_of<Nothing>();
    CHECK(d.fields().empty());
    CHECK(d.leaves().empty());
    CHECK(d.size() == sizeof(Nothing));
    CHECK(DescriptionBuilder("nothing").build().or_throw()->size() == sizeof(Nothing));
  }

  TEST_CASE("US-24 a payload made field by field lies in memory as the C++ struct does") {
    const auto by_hand = everything_by_hand().build().or_throw();
    const auto& by_type = description_of<Everything>();
    const auto lines = by_type->differences(*by_hand);
    CHECK_MESSAGE(lines.empty(), (lines.empty() ? "" : lines[0]));
    CHECK(by_type->same_meaning(*by_hand));
    CHECK(by_type->same_layout(*by_hand));
    CHECK(by_type->size() == by_hand->size());
    CHECK(by_type->alignment() == by_hand->alignment());
    CHECK(by_type->serial() != by_hand->serial());
  }

  TEST_CASE("a description survives JSON, layout included") {
    const auto& d = description_of<Everything>();
    const auto back = Description::from_json(d->to_json()).or_throw();
    CHECK(back->same_meaning(*d));
    CHECK(back->same_layout(*d));
    CHECK(back->to_json() == d->to_json());
    CHECK(description_of<Climate>()->to_json() ==
          R"({"name":"climate","fields":[{"name":"temperature","type":"double","unit":"Cel"},)"
          R"({"name":"humidity","type":"double","unit":"%RH"}]})");
  }

  TEST_CASE("members of a base are described; a struct with a constructor can be described") {
    const Description& d = *description_of<Derived>();
    REQUIRE(d.leaves().size() == 3);
    const Derived value;
    CHECK(d.find("c")->offset ==
          static_cast<std::size_t>(reinterpret_cast<const char*>(&value.c) - reinterpret_cast<const char*>(&value)));
    CHECK(description_of<WithConstructor>()->name() == "WithConstructor");
    CHECK(description_of<WithConstructor>()->leaves()[0].unit == "V");
  }

  TEST_CASE("differences are listed field by field") {
    const auto here = DescriptionBuilder("climate")
                          .field("temperature", Kind::f64, "K")
                          .field("extra", Kind::i32)
                          .field("humidity", Kind::f32, "%RH")
                          .build()
                          .or_throw();
    const auto lines = here->differences(*description_of<Climate>());
    REQUIRE(lines.size() == 3);
    CHECK(lines[0] == "field temperature: unit K here, Cel there");
    CHECK(lines[1] == "field extra: only here");
    CHECK(lines[2] == "field humidity: type float here, double there");
    const auto turned = DescriptionBuilder("weather")
                            .field("humidity", Kind::f64, "%RH")
                            .field("temperature", Kind::f64, "Cel")
                            .build()
                            .or_throw();
    const auto more = turned->differences(*description_of<Climate>());
    REQUIRE(more.size() == 2);
    CHECK(more[0] == "record name weather here, climate there");
    CHECK(more[1] == "field humidity: number 1 here, 2 there");
    CHECK(description_of<Climate>()->differences(*description_of<Climate>()).empty());
  }

  TEST_CASE("descriptions that cannot be used are refused, with the place") {
    const auto error = [](DescriptionBuilder builder) {
      auto result = builder.build();
      REQUIRE_FALSE(result);
      CHECK(result.error().code == Errc::bad_description);
      return result.error().text();
    };
    using B = DescriptionBuilder;
    CHECK(error(B("a b")).find("record \"a b\"") != std::string::npos);
    CHECK(error(B("r").field("1x", Kind::f64)).find("1x") != std::string::npos);
    CHECK(error(B("r").field("a", Kind::f64).field("A", Kind::f64)).find("twice") != std::string::npos);
    for (const char* taken : {"time", "Origin", "sequence", "run"}) {
      CHECK(error(B("r").field(taken, Kind::f64)).find("device_") != std::string::npos);
    }
    CHECK(error(B("r").field("t", Kind::text)).find("text()") != std::string::npos);
    CHECK(error(B("r").text("t", 0)).find("65535") != std::string::npos);
    CHECK(error(B("r").text("t", 70000)).find("65535") != std::string::npos);
    CHECK(error(B("r").array("a", Kind::f64, 0)).find("at least one") != std::string::npos);
    CHECK(error(B("r").array("a", Kind::f64, std::numeric_limits<std::size_t>::max())).find("too large") !=
          std::string::npos);
    CHECK(error(B("r").array("a", Kind::f64, 1 << 23)).find("larger") != std::string::npos);
    CHECK(error(B("r").enumeration("e", {})).find("at least one value") != std::string::npos);
    CHECK(error(B("r").enumeration("e", {{"a", 1}, {"a", 2}})).find("twice") != std::string::npos);
    CHECK(error(B("r").enumeration("e", {{"a", 1}, {"b", 1}})).find("number 1") != std::string::npos);
    CHECK(error(B("r").enumeration("e", {{"a", 300}}, Kind::u8)).find("uint8") != std::string::npos);
    CHECK(error(B("r").enumeration("e", {{"a", 300}}, Kind::f64)).find("integer") != std::string::npos);
    // A nested record may have a field called time: its path is another.
    const auto inner = B("inner").field("x", Kind::f64).build().or_throw();
    CHECK(B("r").record("time_of", *inner).build());
    CHECK_FALSE(B("r").record("time", *inner).build());
  }

  TEST_CASE("JSON that is no description is refused") {
    for (const char* text : {"",
                             "[",
                             "{}",
                             "[]",
                             "3",
                             R"({"name":"r"})",
                             R"({"name":"r","fields":{}})",
                             R"({"name":3,"fields":[]})",
                             R"({"name":"r","fields":[3]})",
                             R"({"name":"r","fields":[{"name":"a"}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"duble"}]})",
                             R"({"name":"r","fields":[{"type":"double"}]})",
                             R"({"name":"r","fields":[],"more":1})",
                             R"({"name":"r","name":"r","fields":[]})",
                             R"({"name":"r","fields":[{"name":"a","type":"double","unti":"V"}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"double","unit":3}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"double","array":-1}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"double","array":0}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"double","array":99999999999999}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"double","capacity":3}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"double","optional":1}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"text"}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"text","capacity":18446744073709551615}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"enum"}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"enum","values":{"x":1.5}}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"enum","values":{"x":1},"base":"double"}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"record"}]})",
                             R"({"name":"r","fields":[{"name":"a","type":"record","fields":[],"optional":true}]})"}) {
      CAPTURE(text);
      const auto result = Description::from_json(text);
      CHECK_FALSE(result);
      if (!result) CHECK(result.error().code == Errc::bad_description);
    }
    CHECK(Description::from_json(R"({"name":"r","fields":[{"name":"a","type":"duble"}]})").error().advice ==
          "did you mean double?");
    std::string deep;
    for (int i = 0; i < 100000; ++i) deep += R"({"name":"r","fields":[)";
    CHECK_FALSE(Description::from_json(deep));
  }

  TEST_CASE("US-24 text holds what fits and refuses the rest") {
    text<5> t = "hello";
    CHECK(t == "hello");
    CHECK(t.size() == 5);
    CHECK_THROWS_AS(text<5>("hello!"), SetupError);
    auto refused = text<5>::make("hello!");
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Errc::does_not_fit);
    CHECK_FALSE(t.assign("too long"));
    CHECK(t == "hello");
    CHECK(t.assign("a"));
    CHECK(t == text<5>("a"));
    CHECK(std::memcmp(&t, "\1\0a\0\0\0\0", sizeof t) == 0);
    CHECK(text<5>("a") < text<5>("b"));
    CHECK(text<5>("a") < "b");
    CHECK(text<5>("a") == std::string("a"));
    CHECK("a" == text<5>("a"));
    CHECK((std::string("b") > text<5>("a") && text<5>("a") != std::string_view("b") && text<5>("a") == text<3>("a")));
    CHECK(text<5>().empty());
    CHECK(sizeof(text<5>) == 7);
    CHECK(alignof(text<5>) == 1);
    static_assert(std::is_trivially_copyable_v<text<5>>);
    std::memset(static_cast<void*>(&t), 0xff, sizeof t);
    CHECK(t.size() == 5);
    CHECK(text<300>(std::string(300, 'x')).size() == 300);
  }

  TEST_CASE("optional access reads and writes the real std::optional") {
    std::optional<double> number = 2.5;
    auto* bytes = reinterpret_cast<std::byte*>(&number);
    const OptionalAccess& access = optional_access(sizeof(double));
    CHECK(access.has_value(bytes));
    CHECK(access.set(bytes, false) == nullptr);
    CHECK_FALSE(number.has_value());
    CHECK_FALSE(access.has_value(bytes));
    REQUIRE(access.set(bytes, true) != nullptr);
    CHECK(number == 0.0);
    std::optional<text<9>> name = "abc";
    CHECK(optional_access(sizeof(text<9>)).has_value(reinterpret_cast<std::byte*>(&name)));
    name.reset();
    CHECK_FALSE(optional_access(sizeof(text<9>)).has_value(reinterpret_cast<std::byte*>(&name)));
  }

  TEST_CASE("US-23 an event is a header, then the payload where its alignment puts it") {
    struct alignas(64) Wide {
      double x;
    };
    const auto place = [](const auto& event) {
      return static_cast<std::size_t>(reinterpret_cast<const char*>(&event.data) -
                                      reinterpret_cast<const char*>(&event));
    };
    CHECK(place(Event<char>{}) == event_payload_offset(1));
    CHECK(place(Event<Climate>{}) == event_payload_offset(alignof(Climate)));
    CHECK(place(Event<Nothing>{}) == event_payload_offset(1));
    CHECK(place(Event<Wide>{}) == event_payload_offset(64));
    const Event<Climate> event{{from_nanoseconds(5), 7, "chamber"}, {21.5, 40}};
    CHECK(static_cast<const void*>(&event.time) == static_cast<const void*>(&event));
    CHECK(event->temperature == 21.5);
    CHECK((*event).humidity == 40);
    static_assert(std::is_trivially_copyable_v<Event<Climate>>);
  }

  TEST_CASE("US-23 US-24 a view gives time, origin and values of any payload") {
    const Event<Climate> event{{from_nanoseconds(5), 7, "chamber"}, {21.5, 40}};
    const EventView view("climate", event);
    CHECK(view.topic() == "climate");
    CHECK(view.origin() == "chamber");
    CHECK(view.sequence() == 7);
    CHECK(view.time() == from_nanoseconds(5));
    CHECK(view.value("humidity").or_throw() == Value(40.0));
    const auto wrong = view.value("humidty");
    REQUIRE_FALSE(wrong);
    CHECK(wrong.error().advice == "did you mean humidity?");
    REQUIRE(view.as<Climate>() != nullptr);
    CHECK(view.as<Climate>() == &event.data);
    CHECK(view.as<Nothing>() == nullptr);

    const auto by_hand = everything_by_hand().build().or_throw();
    alignas(16) std::byte memory[sizeof(Everything) + 1] = {};
    CHECK(EventView("t", event, *by_hand, {memory, by_hand->size()}).as<Everything>() != nullptr);
    CHECK(EventView("t", event, *by_hand, {memory + 1, by_hand->size()}).as<Everything>() == nullptr);
    CHECK(EventView("t", event, *by_hand, {memory, 3}).as<Everything>() == nullptr);
    const auto other_unit = DescriptionBuilder("climate")
                                .field("temperature", Kind::f64, "K")
                                .field("humidity", Kind::f64, "%RH")
                                .build()
                                .or_throw();
    CHECK(EventView("t", event, *other_unit, {memory, other_unit->size()}).as<Climate>() == nullptr);
  }
}
