#include "rtdata/data/codec.hpp"

#include <doctest/doctest.h>

#include <bit>
#include <charconv>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <random>

#include "data/payloads.hpp"

using namespace rtdata;
using namespace payloads;

namespace {

using Bytes = std::vector<std::byte>;

std::string_view as_text(const Bytes& bytes) { return {reinterpret_cast<const char*>(bytes.data()), bytes.size()}; }
std::span<const std::byte> as_bytes(std::string_view text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

Event<Everything> full_event() {
  return {{from_nanoseconds(1'772'366'400'123'456'789), 42, "cha\"mber, 1"}, payloads::full()};
}

template <class T>
void check_round_trip(Codec& codec, const Event<T>& event) {
  Bytes bytes;
  encode(codec, "a/topic", event, bytes).or_throw();
  CAPTURE(as_text(bytes));
  CHECK(codec.first_event(bytes) == bytes.size());
  const auto back = decode<T>(codec, bytes).or_throw();
  CHECK((back.topic == "a/topic" || codec.name() == "csv"));
  CHECK(back.origin == event.origin);
  CHECK(back.time == event.time);
  if (back.sequence) CHECK(*back.sequence == event.sequence);
  CHECK(back.data == event.data);
}

std::vector<std::unique_ptr<Codec>> shipped() {
  std::vector<std::unique_ptr<Codec>> codecs;
  codecs.push_back(make_json_codec());
  codecs.push_back(make_raw_codec());
  codecs.push_back(make_raw_codec({.sequence = RawConfig::Sequence::include}));
  codecs.push_back(make_csv_codec());
  codecs.push_back(make_csv_codec({.time = CsvConfig::TimeFormat::iso8601}));
  codecs.push_back(make_cbor_codec());
  return codecs;
}

struct Number {
  double d = 0;
  float f = 0;
  RTDATA_FIELDS(Number, (d), (f))
};

struct Note {
  text<16> words;
  RTDATA_FIELDS(Note, (words))
};

struct Letter {
  char c = 'x';
  RTDATA_FIELDS(Letter, (c))
};

struct Small {
  std::int32_t i = 0;
  std::optional<double> d;
  char c = 'x';
  text<4> t;
  bool b = false;
  std::array<std::uint8_t, 2> a{};
  RTDATA_FIELDS(Small, (i), (d), (c), (t), (b), (a))
  bool operator==(const Small&) const = default;
};

std::string small_json(std::string_view data) {
  return R"({"topic":"t","time":1,"origin":"o","sequence":2,"data":)" + std::string(data) + "}";
}

/// A format from outside the library: key=value, split by semicolons.
class KeyValueCodec final : public Codec {
 public:
  std::string_view name() const noexcept override { return "key-value"; }
  Result<void> encode(const EventView& event, std::vector<std::byte>& out) override {
    std::string line(event.topic());
    line += ";" + std::to_string(to_nanoseconds(event.time())) + ";" + std::string(event.origin());
    for (const Leaf& leaf : event.description().leaves()) line += ";" + leaf.path + "=" + to_string(event.value(leaf));
    line += '\n';
    const auto bytes = as_bytes(line);
    out.insert(out.end(), bytes.begin(), bytes.end());
    return {};
  }
  Result<DecodedEvent> decode(std::span<const std::byte> bytes, const Description& description) override {
    std::vector<std::string> parts(1);
    for (const std::byte b : bytes) {
      if (const char c = static_cast<char>(b); c == ';') {
        parts.emplace_back();
      } else if (c != '\n') {
        parts.back() += c;
      }
    }
    DecodedEvent event;
    if (parts.size() != 3 + description.leaves().size()) return Error{Errc::bad_data, "fields are missing", "", "", ""};
    event.topic = parts[0];
    event.time = from_nanoseconds(std::stoll(parts[1]));
    event.origin = parts[2];
    event.payload.resize(description.size());
    for (std::size_t i = 0; i < description.leaves().size(); ++i) {
      const Leaf& leaf = description.leaves()[i];
      const std::string value = parts[3 + i].substr(leaf.path.size() + 1);
      if (auto done = write(leaf, event.payload.data(), std::stod(value)); !done) return done.error();
    }
    return event;
  }
};

}  // namespace

TEST_SUITE("data") {
  TEST_CASE("US-31 every format gives back an equal event, for every kind of value") {
    for (const auto& codec : shipped()) {
      CAPTURE(codec->name());
      check_round_trip(*codec, full_event());
      Event<Everything> plain{{from_nanoseconds(-1), 0, ""}, {}};
      plain.data.maybe = 0;
      plain.data.maybe_name = text<5>("x");
      plain.data.maybe_state = State::idle;
      plain.data.maybe_flag = true;
      plain.data.maybes = {0U, 1U};
      check_round_trip(*codec, plain);
      check_round_trip(*codec, Event<Nothing>{{from_nanoseconds(5), 1, "button"}, {}});
      check_round_trip(*codec, Event<Climate>{{from_nanoseconds(5), 1, "c"}, {21.5, 1e17}});
      if (codec->name() != "raw") {
        check_round_trip(*codec, Event<Everything>{{from_nanoseconds(5), 1, "all absent"}, {}});
      }
      for (int c = 0; c < 256; ++c) {
        check_round_trip(*codec, Event<Small>{{{}, 1, "o"}, {1, 2.0, static_cast<char>(c), {}, false, {}}});
      }
    }
  }

  TEST_CASE("US-31 NFR-2 a char is a number from 0 to 255 in every format, on every processor") {
    const auto json = make_json_codec();
    const auto raw = make_raw_codec();
    const auto csv = make_csv_codec();
    for (unsigned code = 1; code < 256; ++code) {  // the zero byte is escaped
      CAPTURE(code);
      const Event<Letter> event{{from_nanoseconds(1), 2, "o"}, {static_cast<char>(code)}};
      // The character of Unicode with that number, in UTF-8.
      std::string utf8;
      if (code < 0x80) {
        utf8 += static_cast<char>(code);
      } else {
        utf8 += code < 0xc0 ? "\xc2" : "\xc3";
        utf8 += static_cast<char>(0x80 + code % 0x40);
      }
      CHECK(to_string(Value(event.data.c)) == utf8);
      Bytes bytes;
      encode(*json, "t", event, bytes).or_throw();
      CHECK(nlohmann::json::parse(as_text(bytes))["data"]["c"] == utf8);
      bytes.clear();
      encode(*csv, "t", event, bytes).or_throw();
      if (utf8.find_first_of("\",\r\n\t ") == std::string::npos) CHECK(as_text(bytes) == "1,o,2," + utf8 + "\n");
      bytes.clear();
      encode(*raw, "t", event, bytes).or_throw();
      CHECK(static_cast<unsigned>(bytes.back()) == code);
    }
    // A byte of its own, as other programs write it, means the same.
    const auto decoded = decode<Letter>(*csv, as_bytes("1,o,2,\xe9\n")).or_throw();
    CHECK(static_cast<unsigned char>(decoded.data.c) == 0xe9);
    CHECK_FALSE(decode<Letter>(*csv, as_bytes("1,o,2,\xc4\x80\n")));  // U+0100
    CHECK_FALSE(decode<Letter>(*csv, as_bytes("1,o,2,\xc3\x28\n")));
  }

  TEST_CASE("US-31 numbers come back bit for bit") {
    std::mt19937_64 random(1);
    for (const auto& codec : shipped()) {
      CAPTURE(codec->name());
      const auto check = [&](double d, float f) {
        Bytes bytes;
        encode(*codec, "t", Event<Number>{{{}, 1, "o"}, {d, f}}, bytes).or_throw();
        CAPTURE(as_text(bytes));
        const Number back = decode<Number>(*codec, bytes).or_throw().data;
        CHECK((std::bit_cast<std::uint64_t>(back.d) == std::bit_cast<std::uint64_t>(d) ||
               (std::isnan(d) && std::isnan(back.d))));
        CHECK((std::bit_cast<std::uint32_t>(back.f) == std::bit_cast<std::uint32_t>(f) ||
               (std::isnan(f) && std::isnan(back.f))));
      };
      using D = std::numeric_limits<double>;
      using F = std::numeric_limits<float>;
      check(D::quiet_NaN(), F::quiet_NaN());
      check(-D::quiet_NaN(), -F::quiet_NaN());
      check(D::infinity(), F::infinity());
      check(-D::infinity(), -F::infinity());
      check(D::denorm_min(), F::denorm_min());
      check(-0.0, -0.0F);
      check(D::max(), F::max());
      check(D::min(), F::min());
      check(1e22, 8388608.5F);
      check(9007199254740993.0, 16777216.0F);
      check(18446744073709551616.0, 18446744073709551616.0F);
      for (int i = 0; i < 3000; ++i) {
        check(std::bit_cast<double>(random()), std::bit_cast<float>(static_cast<std::uint32_t>(random())));
        check(static_cast<double>(random()), static_cast<float>(random()));
      }
    }
  }

  TEST_CASE("US-31 JSON numbers have the digits of std::to_chars") {
    auto codec = make_json_codec();
    const auto check = [&](double d) {
      char digits[40];
      const std::string expected(digits, std::to_chars(digits, digits + sizeof digits, d).ptr);
      Bytes bytes;
      encode(*codec, "t", Event<Number>{{{}, 1, "o"}, {d, 1}}, bytes).or_throw();
      CHECK(as_text(bytes).find(R"("data":{"d":)" + expected + ",") != std::string_view::npos);
    };
    for (const double unit : {1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6, 1e7}) {
      for (int i = 1; i < 1200; ++i) {
        const double d = (i % 7 == 0 ? 1000 : 1) * i / unit;
        check(d);
        check(-d);
        check(std::nextafter(d, 0));
        check(std::nextafter(d, 1e9));
        check(d / 3);
      }
    }
    for (const double d :
         {1e-3, 1e5, 99999.999999, 0.000999, 100000.5, 5e-7, 12345.678901, 4.35, 0.30000000000000004}) {
      check(d);
      check(std::nextafter(d, 0));
    }
  }

  TEST_CASE("US-31 JSON: one object a line, as documented") {
    auto codec = make_json_codec();
    Bytes bytes;
    encode(*codec, "climate", Event<Climate>{{from_nanoseconds(1'772'366'400'000'000'000), 7, "chamber"}, {21.5, 0.1}},
           bytes)
        .or_throw();
    CHECK(as_text(bytes) ==
          "{\"topic\":\"climate\",\"time\":1772366400000000000,\"origin\":\"chamber\",\"sequence\":7,"
          "\"data\":{\"temperature\":21.5,\"humidity\":0.1}}\n");
    bytes.clear();
    encode(*codec, "all", full_event(), bytes).or_throw();
    const auto tree = nlohmann::json::parse(as_text(bytes));
    CHECK(tree["data"]["letter"] == "\u00e4");
    CHECK(tree["data"]["state"] == "broken");
    CHECK(tree["data"]["states"][1] == -9);
    CHECK(tree["data"]["points"][1]["label"] == -3);
    CHECK(tree["data"]["u64"] == std::numeric_limits<std::uint64_t>::max());
    // Appended to what is there, again and again.
    const std::size_t one = bytes.size();
    encode(*codec, "all", full_event(), bytes).or_throw();
    CHECK(bytes.size() == 2 * one);
    CHECK(codec->first_event(bytes) == one);
  }

  TEST_CASE("US-31 JSON: text that is no UTF-8 still gives valid JSON") {
    auto codec = make_json_codec();
    for (const char* text :
         {"\xff", "\xc0\x80", "\xed\xa0\x80", "\xf4\x90\x80\x80", "\xe4", "a\x80z", "\xc3", "\xf0\x9f\x98"}) {
      Bytes bytes;
      Event<Small> event{{{}, 1, text}, {}};
      event.data.t = std::string_view(text).substr(0, 4);
      encode(*codec, text, event, bytes).or_throw();
      CAPTURE(as_text(bytes));
      CHECK(nlohmann::json::accept(as_text(bytes)));
    }
    for (const char* text : {"\xf0\x9f\x98\x80", "\xe2\x82\xac", "\x7f", "\x01\x1f"}) {
      Event<Small> event{{{}, 1, text}, {}};
      event.data.t = text;
      event.data.d = 1;
      check_round_trip(*codec, event);
    }
  }

  TEST_CASE("US-31 JSON and CSV: text that is no UTF-8 comes back equal") {
    for (const char* format : {"json", "csv"}) {
      auto codec = CodecRegistry::standard().make(format).or_throw();
      for (const std::string& text : {std::string("\xff"), std::string("a\x80z"), std::string("\0", 1),
                                      std::string("\\x5c"), std::string("\\"), std::string("\xff\xff\xff\xff")}) {
        Event<Small> event{{{}, 1, "o"}, {}};
        event.data.t = text;
        event.data.c = text[0];
        event.data.d = -0.0;
        Bytes bytes;
        encode(*codec, "t", event, bytes).or_throw();
        CAPTURE(as_text(bytes));
        CHECK(as_text(bytes).find('\xff') == std::string::npos);
        CHECK(as_text(bytes).find('\0') == std::string::npos);
        const auto same = decode<Small>(*codec, bytes).or_throw();
        CHECK(same.data == event.data);
        CHECK(std::signbit(*same.data.d));
      }
    }
  }

  TEST_CASE("US-31 CSV and JSON: numbers and flags as users write them") {
    auto csv = make_csv_codec();
    const auto read = [&](const std::string& row) { return decode<Small>(*csv, as_bytes(row)).or_throw().data; };
    CHECK(read("5,o,2,-0,1e-400,x,abc,TRUE,-0,2").d == 0);
    CHECK(read("5,o,2,1,-1e-400,x,abc,False,0,2").d == 0);
    CHECK(std::signbit(*read("5,o,2,1,-0.0000001e-399,x,abc,False,0,2").d));
    CHECK(read("\xef\xbb\xbf"
               "5,o,2,1,+1.5,x,abc,1,0,2")
              .b);
    CHECK_FALSE(decode<Small>(*csv, as_bytes("5,o,2,1,1e400,x,abc,1,0,2")));
    CHECK_FALSE(decode<Small>(*csv, as_bytes("5,o,2,1,1000000e399,x,abc,1,0,2")));
    auto json = make_json_codec();
    const auto number = [&](const std::string& text) {
      return decode<Small>(*json,
                           as_bytes(small_json(R"({"i":-0,"d":)" + text + R"(,"c":"x","t":"","b":true,"a":[1,2]})")))
          .or_throw()
          .data.d;
    };
    CHECK(std::signbit(*number("-0")));
    CHECK_FALSE(std::signbit(*number("0")));
    CHECK(number("1e-400") == 0);
  }

  TEST_CASE("US-31 JSON: wrong input is refused") {
    auto codec = make_json_codec();
    const auto read = [&](const std::string& text) { return decode<Small>(*codec, as_bytes(text)); };
    const std::string good = R"({"i":1,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,2]})";
    REQUIRE(read(small_json(good)));
    CHECK(read(small_json(R"({"a":[1,2],"b":true,"t":"abc","c":"x","d":null,"i":1.0})")));
    CHECK(read(R"({"data":)" + good + R"(,"topic":"t","time":1,"origin":"o"})"));
    for (const char* data : {"{}",
                             "[]",
                             "3",
                             "null",
                             R"({"i":1,"d":2.5,"c":"x","t":"abc","b":true})",
                             R"({"i":1,"i":1,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":1,"i":1,"d":2.5,"c":"x","t":"abc","b":true})",
                             R"({"i":1,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,2],"z":1})",
                             R"({"i":3.7,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":1e10,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":true,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":"1","d":2.5,"c":"x","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":null,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":1,"d":[],"c":"x","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":1,"d":{},"c":"x","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":1,"d":"nan","c":"x","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":1,"d":1e999,"c":"x","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":1,"d":2.5,"c":"xy","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":1,"d":2.5,"c":"","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":1,"d":2.5,"c":"\u20ac","t":"abc","b":true,"a":[1,2]})",
                             R"({"i":1,"d":2.5,"c":"x","t":"abcde","b":true,"a":[1,2]})",
                             R"({"i":1,"d":2.5,"c":"x","t":"abc","b":1,"a":[1,2]})",
                             R"({"i":1,"d":2.5,"c":"x","t":"abc","b":true,"a":[1]})",
                             R"({"i":1,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,2,3]})",
                             R"({"i":1,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,256]})",
                             R"({"i":1,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,-1]})",
                             R"({"i":1,"d":2.5,"c":"x","t":"abc","b":true,"a":1})"}) {
      CAPTURE(data);
      CHECK_FALSE(read(small_json(data)));
    }
    for (const char* text :
         {"", " ", "{", "null", "[]", "\"\"", "{}", R"({"topic":"t"})",
          R"({"topic":1,"time":1,"origin":"o","data":{}})", R"({"topic":"t","time":1.5,"origin":"o","data":{}})",
          R"({"topic":"t","time":9223372036854775808,"origin":"o","data":{}})",
          R"({"topic":"t","time":1,"origin":2,"data":{}})", R"({"topic":"t","time":1,"origin":"o"})",
          R"({"topic":"t","time":1,"origin":"o","sequence":-1,"data":{}})",
          R"({"topic":"t","topic":"t","time":1,"origin":"o","data":{}})"}) {
      CAPTURE(text);
      CHECK_FALSE(decode<Nothing>(*codec, as_bytes(text)));
    }
    CHECK(decode<Nothing>(*codec, as_bytes(R"({"topic":"t","time":1,"origin":"o","data":{}})")));
    CHECK_FALSE(read(small_json(good) + "x"));
    CHECK_FALSE(read(small_json(good) + small_json(good)));
    CHECK_FALSE(read(std::string(100000, '[')));
    const std::string whole = small_json(good);
    for (std::size_t i = 0; i < whole.size(); ++i) CHECK_FALSE(read(whole.substr(0, i)));
    CHECK(read(small_json(R"({"I":1,"d":2.5,"c":"x","t":"abc","b":true,"a":[1,2]})"))
              .error()
              .text()
              .find("unknown key I") != std::string::npos);
  }

  TEST_CASE("US-31 raw bytes: the layout of the requirement, byte for byte") {
    auto codec = make_raw_codec();
    Bytes bytes;
    encode(*codec, "ab",
           Event<Small>{{from_nanoseconds(0x0102030405060708), 9, "o"}, {-2, 1.0, 'x', "hi", true, {7, 8}}}, bytes)
        .or_throw();
    const unsigned char expected[] = {44,                                            // what follows
                                      0,  0,    0,                                   //
                                      2,  'a',  'b',                                 // topic
                                      8,  8,    7,    6,    5,    4, 3, 2,    1,     // time
                                      1,  'o',                                       // origin
                                      4,  0xfe, 0xff, 0xff, 0xff,                    // i
                                      8,  0,    0,    0,    0,    0, 0, 0xf0, 0x3f,  // d
                                      1,  'x',                                       // c
                                      2,  'h',  'i',                                 // t
                                      1,  1,                                         // b
                                      2,  7,    8};                                  // a
    std::string_view wanted(reinterpret_cast<const char*>(expected), sizeof expected);
    const auto sized = static_cast<char>(sizeof expected - 4);
    CHECK(as_text(bytes).substr(4) == wanted.substr(4));
    CHECK(as_text(bytes)[0] == sized);
    CHECK(as_text(bytes).substr(1, 3) == std::string_view("\0\0\0", 3));
    // With its sequence number, and flattened.
    auto numbered = make_raw_codec({.sequence = RawConfig::Sequence::include});
    Bytes more;
    encode(*numbered, "ab", Event<Nothing>{{from_nanoseconds(1), 9, "o"}, {}}, more).or_throw();
    CHECK(more.size() == 4 + 3 + 9 + 2 + 9);
    CHECK(decode<Nothing>(*numbered, more).or_throw().sequence == 9U);
    CHECK_FALSE(decode<Nothing>(*codec, more));
    CHECK_FALSE(decode<Nothing>(*codec, bytes));
    CHECK(decode<Small>(*codec, bytes).or_throw().sequence == std::nullopt);
  }

  TEST_CASE("US-31 raw bytes do not depend on the events encoded before") {
    Bytes together;
    Bytes apart;
    for (const auto sequence : {RawConfig::Sequence::omit, RawConfig::Sequence::include}) {
      auto shared = make_raw_codec({.sequence = sequence});
      const auto encode_both = [&](std::string_view topic, const auto& event) {
        encode(*shared, topic, event, together).or_throw();
        encode(*make_raw_codec({.sequence = sequence}), topic, event, apart).or_throw();
      };
      std::uint64_t number = 0;
      for (const std::string_view topic :
           {"ab", "ac", "a topic of more than sixteen bytes", "a topic of more than Sixteen bytes", ""}) {
        for (const std::string_view origin : {"o", "origin", "o", "origins", "an origin", "an_origin"}) {
          for (int i = 0; i < 3; ++i) {
            ++number;
            const EventHeader header{from_nanoseconds(static_cast<std::int64_t>(number) * 1001), number, origin};
            encode_both(topic, Event<Number>{header, {1.5 * i, 0.5F * static_cast<float>(i)}});
            encode_both(topic, Event<Number>{header, {-1.5 * i, 2.5F}});
            if (i == 1) encode_both(topic, Event<Small>{header, {-2, 1.0, 'x', "hi", true, {7, 8}}});
          }
        }
      }
    }
    CHECK(together == apart);
  }

  TEST_CASE("US-31 raw bytes: what does not fit is an error, not a cut, and appends nothing") {
    auto codec = make_raw_codec();
    Bytes bytes{std::byte{1}};
    const auto refuse = [&](const Result<void>& done) {
      REQUIRE_FALSE(done);
      CHECK(done.error().code == Errc::does_not_fit);
      CHECK(bytes.size() == 1);
    };
    refuse(encode(*codec, "t", Event<Small>{{{}, 1, "o"}, {}}, bytes));  // absent
    refuse(encode(*codec, std::string(256, 't'), Event<Nothing>{}, bytes));
    const std::string origin(256, 'o');
    refuse(encode(*codec, "t", Event<Nothing>{{{}, 1, origin}, {}}, bytes));
    CHECK(encode(*codec, std::string(255, 't'), Event<Nothing>{}, bytes));
    bytes.resize(1);
    const auto inner = DescriptionBuilder("inner").text("t", 300).build().or_throw();
    const auto outer = DescriptionBuilder("outer").record_array("points", *inner, 2).build().or_throw();
    Bytes points(outer->size());
    write(*outer->find("points[1].t"), points.data(), std::string(256, 'x')).or_throw();
    const auto nested = codec->encode(EventView("t", {}, *outer, points), bytes);
    refuse(nested);
    CHECK(nested.error().where == "field points[1].t");
    const auto wide = DescriptionBuilder("wide").array("a", Kind::f64, 32).build().or_throw();
    const Bytes payload(wide->size());
    refuse(codec->encode(EventView("t", {}, *wide, payload), bytes));
    const auto fits = DescriptionBuilder("fits").array("a", Kind::f64, 31).build().or_throw();
    CHECK(codec->encode(EventView("t", {}, *fits, std::span(payload).first(fits->size())), bytes));
    bytes.resize(1);
    struct Long {
      text<300> t;
    };
    const auto description = DescriptionBuilder("long").text("t", 300).build().or_throw();
    Long value{std::string(256, 'x')};
    refuse(codec->encode(EventView("t", {}, *description, std::as_bytes(std::span(&value, 1))), bytes));
    value.t = std::string(255, 'x');
    CHECK(codec->encode(EventView("t", {}, *description, std::as_bytes(std::span(&value, 1))), bytes));
  }

  TEST_CASE("US-31 raw bytes: anything too short, too long or of a wrong size is refused") {
    auto codec = make_raw_codec();
    Bytes bytes;
    encode(*codec, "ab", full_event(), bytes).or_throw();
    const auto set_size = [](Bytes& b) {
      for (std::size_t i = 0; i < 4; ++i) b[i] = static_cast<std::byte>((b.size() - 4) >> (8 * i));
    };
    for (std::size_t size = 0; size < bytes.size(); ++size) {
      Bytes cut(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(size));
      CHECK_FALSE(decode<Everything>(*codec, cut));
      CHECK(codec->first_event(cut) == 0);
      if (size < 4) continue;
      set_size(cut);
      CHECK_FALSE(decode<Everything>(*codec, cut));
    }
    Bytes longer = bytes;
    longer.push_back(std::byte{0});
    CHECK(codec->first_event(longer) == bytes.size());
    CHECK_FALSE(decode<Everything>(*codec, longer));
    set_size(longer);
    CHECK_FALSE(decode<Everything>(*codec, longer));
    // A bool of 2: flag is the first field.
    Bytes wrong = bytes;
    const std::size_t flag = 4 + 3 + 9 + 1 + full_event().origin.size() + 1;
    REQUIRE(wrong[flag] == std::byte{1});
    wrong[flag] = std::byte{2};
    CHECK_FALSE(decode<Everything>(*codec, wrong));
  }

  TEST_CASE("US-31 CSV: header, quoting") {
    const Description& d = *description_of<Everything>();
    auto codec = make_csv_codec();
    CHECK(csv_header(*description_of<Climate>()) == "time,origin,sequence,temperature,humidity\n");
    CHECK(codec->header(*description_of<Climate>()) == csv_header(*description_of<Climate>()));
    CHECK(csv_header(d).find(",points[1].x,") != std::string::npos);
    Bytes bytes;
    encode(*codec, "t", Event<Small>{{from_nanoseconds(5), 2, "a,b"}, {1, std::nullopt, '"', "x\ny", true, {1, 2}}},
           bytes)
        .or_throw();
    CHECK(as_text(bytes) == "5,\"a,b\",2,1,,\"\"\"\",\"x\ny\",true,1,2\n");
    bytes.push_back(std::byte{'5'});
    CHECK(codec->first_event(bytes) == bytes.size() - 1);
    CHECK(decode<Small>(*codec, as_bytes("1970-01-01T00:00:00.5Z,o,,1,,x,abc,false,1,2\r\n")).or_throw().time ==
          from_nanoseconds(500'000'000));
  }

  TEST_CASE("US-31 CSV: wrong input is refused") {
    auto codec = make_csv_codec();
    REQUIRE(decode<Small>(*codec, as_bytes("5,o,2,1,,x,abc,true,1,2")));
    for (const char* row : {"",
                            "\n",
                            "5,o,2,1,,x,abc,true,1",
                            "5,o,2,1,,x,abc,true,1,2,3",
                            "5,o,2,1,,x,abc,true,1,2\n\n",
                            "5,o,2,1,,x,abc,true,1,2\nx",
                            "5,o,2,1,,x,abc,true,1,2\r",
                            "x,o,2,1,,x,abc,true,1,2",
                            "5,o,-2,1,,x,abc,true,1,2",
                            "5,o,2,,,x,abc,true,1,2",
                            "5,o,2,1.5,,x,abc,true,1,2",
                            "5,o,2,1x,,x,abc,true,1,2",
                            "5,o,2, 1,,x,abc,true,1,2",
                            "5,o,2,99999999999,,x,abc,true,1,2",
                            "5,o,2,1,abc,x,abc,true,1,2",
                            "5,o,2,1,1e999,x,abc,true,1,2",
                            "5,o,2,1,,xy,abc,true,1,2",
                            "5,o,2,1,,,abc,true,1,2",
                            "5,o,2,1,,x,abcde,true,1,2",
                            "5,o,2,1,,x,abc,yes,1,2",
                            "5,o,2,1,,x,abc,true,256,2",
                            "5,o,2,1,,x,\"abc,true,1,2",
                            "5,o,2,1,,x,a\"bc,true,1,2",
                            "5,o,2,1,,x,\"a\"bc,true,1,2"}) {
      CAPTURE(row);
      CHECK_FALSE(decode<Small>(*codec, as_bytes(row)));
    }
  }

  TEST_CASE("US-31 NFR-6 a format from outside is added under its name") {
    CodecRegistry registry = CodecRegistry::standard();
    CHECK(registry.names() == std::vector<std::string>{"cbor", "csv", "influx", "json", "raw"});
    CHECK(registry.add("key-value", [] { return std::make_unique<KeyValueCodec>(); }));
    const auto twice = registry.add("json", [] { return make_json_codec(); });
    REQUIRE_FALSE(twice);
    CHECK(twice.error().code == Errc::bad_name);
    CHECK_FALSE(registry.add("", [] { return make_json_codec(); }));
    CHECK_FALSE(registry.add("none", nullptr));
    CHECK(registry.find("json") != nullptr);
    CHECK(registry.find("jsn") == nullptr);
    CHECK(registry.make("jsn").error().advice == "did you mean json?");
    auto codec = registry.make("key-value").or_throw();
    check_round_trip(*codec, Event<Climate>{{from_nanoseconds(5), 1, "c"}, {21.5, 40}});
    CHECK(codec->header(*description_of<Climate>()).empty());
  }

  TEST_CASE("one JSON codec takes many descriptions, also ones that come and go") {
    auto codec = make_json_codec();
    for (int i = 0; i < 1000; ++i) {
      const auto name = "f" + std::to_string(i);
      const auto d = DescriptionBuilder("r").field(name, Kind::i32).build().or_throw();
      const Bytes payload(d->size());
      Bytes bytes;
      codec->encode(EventView("t", {}, *d, payload), bytes).or_throw();
      CHECK(as_text(bytes).find("\"" + name + "\":0") != std::string::npos);
    }
  }

  TEST_CASE("what a codec wrote before never shows in an event: topics, origins and runs in any order") {
    for (const char* name : {"json", "cbor", "influx", "raw", "csv"}) {
      CAPTURE(name);
      const auto used = CodecRegistry::standard().make(name).or_throw();
      std::string topic = "room", origin = "chamber", run = "8e03978e-40d5-43e8-bc93-6894a57f9324";
      std::uint64_t sequence = 0;
      const auto check = [&] {
        CAPTURE(topic + " " + origin + " " + run);
        const Event<Climate> event{{from_nanoseconds(static_cast<std::int64_t>(++sequence) * 100), sequence, origin},
                                   {21.5, 40}};
        const EventView plain(topic, event);
        const EventView view(topic, event, plain.description(), plain.payload(), run);
        Bytes bytes, fresh;
        used->encode(view, bytes).or_throw();
        CodecRegistry::standard().make(name).or_throw()->encode(view, fresh).or_throw();
        CHECK(as_text(bytes) == as_text(fresh));
      };
      check();
      topic[0] = 'z';  // in the same place in memory, as long as before
      check();
      origin[0] = 'C';
      check();
      run[0] = '9';
      check();
      run.clear();
      check();
      topic += "/a", origin.clear();
      check();
      std::swap(topic, origin = "x");
      check();
      run = "\"\\";
      check();
    }
  }

  TEST_CASE("US-31 CBOR is what RFC 8949 says, and what others write of it is read") {
    const auto codec = make_cbor_codec();
    const Event<Small> event{{from_nanoseconds(1), 300, "o"}, {-500, std::nullopt, 'x', text<4>("ab"), true, {1, 255}}};
    Bytes bytes;
    encode(*codec, "t", event, bytes).or_throw();
    const auto tree = nlohmann::json::from_cbor(std::vector<std::uint8_t>(
        reinterpret_cast<std::uint8_t*>(bytes.data()), reinterpret_cast<std::uint8_t*>(bytes.data()) + bytes.size()));
    CHECK(tree == nlohmann::json::parse(R"({"topic":"t","time":1,"origin":"o","sequence":300,
        "data":{"i":-500,"d":null,"c":"x","t":"ab","b":true,"a":[1,255]}})"));
    // The head of the map, then "topic".
    CHECK(std::vector<int>{static_cast<int>(bytes[0]), static_cast<int>(bytes[1]), static_cast<int>(bytes[2])} ==
          std::vector<int>{0xa5, 0x65, 't'});

    const auto read = [&](const nlohmann::json& data) {
      const auto other = nlohmann::json::to_cbor(
          nlohmann::json{{"topic", "t"}, {"time", 1}, {"origin", "o"}, {"sequence", 2}, {"data", data}});
      return decode<Small>(*codec, std::as_bytes(std::span(other)));
    };
    const nlohmann::json good{{"i", 7}, {"d", 2.5}, {"c", "x"}, {"t", "abcd"}, {"b", false}, {"a", {1, 2}}};
    CHECK(read(good).or_throw().data == Small{7, 2.5, 'x', text<4>("abcd"), false, {1, 2}});
    const auto with = [&](const char* key, const nlohmann::json& value) {
      auto changed = good;
      changed[key] = value;
      return read(changed);
    };
    CHECK(with("d", 1e300));
    CHECK(with("d", nullptr));
    CHECK(with("d", 3));
    CHECK_FALSE(with("i", 1.5));
    CHECK_FALSE(with("i", 5'000'000'000));
    CHECK_FALSE(with("i", nullptr));
    CHECK_FALSE(with("t", "abcde"));
    CHECK_FALSE(with("a", nlohmann::json::array({1})));
    CHECK_FALSE(with("a", nlohmann::json::array({1, 256})));
    CHECK_FALSE(with("z", 1));
    // Names longer than what is copied at once, floats of both sizes, present and absent.
    auto made = DescriptionBuilder("long")
                    .field("a_name_of_more_than_sixteen_letters", Kind::f32, "m")
                    .field("b", Kind::f64, "m")
                    .field("another_name_of_more_than_sixteen_letters", Kind::f64, "m")
                    .build()
                    .or_throw();
    std::vector<std::byte> payload(made->size());
    const float single = -1.5F;
    const double numbers[] = {0.1, -1e300};
    const auto put_at = [&](const char* path, const void* from, std::size_t size) {
      std::memcpy(payload.data() + made->find(path)->offset, from, size);
    };
    put_at("a_name_of_more_than_sixteen_letters", &single, sizeof single);
    put_at("b", &numbers[0], sizeof numbers[0]);
    put_at("another_name_of_more_than_sixteen_letters", &numbers[1], sizeof numbers[1]);
    bytes.clear();
    codec->encode(EventView("t", EventHeader{from_nanoseconds(1), 2, "o"}, *made, payload), bytes).or_throw();
    const auto of_long = nlohmann::ordered_json::parse(
        R"({"topic":"t","time":1,"origin":"o","sequence":2,"data":{"a_name_of_more_than_sixteen_letters":-1.5,
            "b":0.1,"another_name_of_more_than_sixteen_letters":-1e300}})");
    const auto expected = nlohmann::ordered_json::to_cbor(of_long);
    CHECK(std::vector<std::uint8_t>(reinterpret_cast<std::uint8_t*>(bytes.data()),
                                    reinterpret_cast<std::uint8_t*>(bytes.data()) + bytes.size()) == expected);
    // -2^64, of which nlohmann's parser makes 0.
    auto below = as_bytes(std::string_view("\xa5\x65topic\x61t\x64time\x3b\xff\xff\xff\xff\xff\xff\xff\xff", 23));
    CHECK(codec->decode(below, *description_of<Small>()).error().code == Errc::out_of_range);
  }

  TEST_CASE("US-31 CBOR of a stream: where each event ends, however it is cut, and never beyond what came") {
    const auto codec = make_cbor_codec();
    Bytes bytes;
    encode(*codec, "a/topic", full_event(), bytes).or_throw();
    const std::size_t one = bytes.size();
    encode(*codec, "a/topic", full_event(), bytes).or_throw();
    for (std::size_t size = 0; size <= bytes.size(); ++size)
      CHECK(codec->first_event(std::span(bytes).first(size)) == (size < one ? 0 : one));
    std::mt19937_64 random(1);
    for (int i = 0; i < 20'000; ++i) {
      Bytes garbage(static_cast<std::size_t>(random() % 40));
      for (auto& byte : garbage) byte = static_cast<std::byte>(random());
      REQUIRE(codec->first_event(garbage) <= garbage.size());
      if (const auto event = codec->decode(garbage, *description_of<Small>()); !event)
        REQUIRE(!event.error().text().empty());
    }
  }

  TEST_CASE("US-31 the run of an event that leaves the machine goes along in JSON, CBOR and lines of InfluxDB") {
    const Event<Small> event{{from_nanoseconds(5), 7, "chamber"}, {}};
    for (const char* name : {"json", "cbor", "influx"}) {
      CAPTURE(name);
      const auto codec = CodecRegistry::standard().make(name).or_throw();
      std::vector<std::byte> bytes, plain;
      const EventView plain_view("t", event);
      const EventView view("t", event, plain_view.description(), plain_view.payload(),
                           "8e03978e-40d5-43e8-bc93-6894a57f9324");
      codec->encode(view, bytes).or_throw();
      codec->encode(plain_view, plain).or_throw();
      const auto back = codec->decode(bytes, *description_of<Small>()).or_throw();
      CHECK(back.run == "8e03978e-40d5-43e8-bc93-6894a57f9324");
      CHECK(back.sequence == 7);
      CHECK(back.origin == "chamber");
      CHECK(codec->decode(plain, *description_of<Small>()).or_throw().run.empty());
      CHECK(bytes.size() > plain.size());
      CHECK(codec->first_event(bytes) == bytes.size());
    }
  }

  TEST_CASE("US-31 lines of InfluxDB: what can be said comes back, what cannot is left out, a line is a line") {
    const auto codec = make_influx_codec();
    Bytes bytes;
    const Event<Climate> climate{{from_nanoseconds(1'772'366'400'000'000'001), 7, "cham ber,1=\"x\""}, {21.5, 1e17}};
    encode(*codec, "room/climate", climate, bytes).or_throw();
    CHECK(as_text(bytes) ==
          "room/climate,origin=cham\\ ber\\,1\\=\"x\" temperature=21.5,humidity=1e+17,sequence=7i "
          "1772366400000000001\n");
    CHECK(codec->first_event(bytes) == bytes.size());
    const auto back = decode<Climate>(*codec, bytes).or_throw();
    CHECK(back.data == climate.data);
    CHECK(back.origin == climate.origin);
    CHECK(back.topic == "room/climate");
    CHECK(back.sequence == 7);

    const Event<Small> small{{from_nanoseconds(-5), 1, ""}, {-1, std::nullopt, '"', text<4>("\\\n\" "), true, {1, 2}}};
    bytes.clear();
    encode(*codec, "t", small, bytes).or_throw();
    CHECK(codec->first_event(bytes) == bytes.size());
    CHECK(decode<Small>(*codec, bytes).or_throw().data == small.data);

    for (const char* text : {"\\x0a", "\n", "\\\n", "\\x5c", "\n\\x", "\xff\n", "a\\"}) {
      Event<Note> note{{from_nanoseconds(5), 1, "o"}, {rtdata::text<16>(text)}};
      bytes.clear();
      encode(*codec, "t", note, bytes).or_throw();
      CHECK(std::count(bytes.begin(), bytes.end(), std::byte{'\n'}) == 1);
      CHECK(decode<Note>(*codec, bytes).or_throw().data.words == note.data.words);
    }

    const double infinity = std::numeric_limits<double>::infinity();
    bytes.clear();
    encode(*codec, "t", Event<Climate>{{from_nanoseconds(5), 1, "o"}, {std::nan(""), infinity}}, bytes).or_throw();
    CHECK(as_text(bytes) == "t,origin=o sequence=1i 5\n");
    CHECK(std::isnan(decode<Climate>(*codec, bytes).or_throw().data.humidity));

    for (const char* origin : {"a\nb", "a\\", "a\\,b", "a\\\\b"}) {
      const std::size_t before = bytes.size();
      CHECK(encode(*codec, "t", Event<Climate>{{from_nanoseconds(5), 1, origin}, {1, 2}}, bytes).error().code ==
            Errc::does_not_fit);
      CHECK(bytes.size() == before);
    }
    for (const char* line :
         {"", "t", "t ", "t x=1 5", "t temperature=1,humidity=2 ", "t temperature=1,humidity=2 x",
          "t temperature=1,temperature=2 5", "t temperature=1i,humidity=1,z=3 5", "t temperature=nan 5",
          "t temperature= 5", "t temperature=\"x 5", "t,origin temperature=1 5", "t temperature=1 5 6"})
      CHECK_FALSE(decode<Climate>(*codec, as_bytes(line)));
    CHECK(decode<Climate>(*codec, as_bytes("t,host=a,origin=b temperature=1i,humidity=2 5")).or_throw().data ==
          Climate{1, 2});
  }
}
