// What the codecs write, written by hand for one payload: the limit beside them. Both return the end.
#pragma once

#include <charconv>
#include <cstdint>
#include <cstring>
#include <string_view>

#include "payloads.hpp"

namespace bench {

inline char* put(char* to, std::string_view text) {
  std::memcpy(to, text.data(), text.size());
  return to + text.size();
}

template <class Number>
char* put_number(char* to, Number number) {
  return std::to_chars(to, to + 40, number).ptr;
}

/// A line of JSON, line end included. `to` has room for 1 KiB.
inline char* json_by_hand(char* to, std::int64_t time, std::uint64_t sequence, const Eight& data) {
  to = put(to, R"({"topic":"test/climate","time":)");
  to = put_number(to, time);
  to = put(to, R"(,"origin":"chamber","sequence":)");
  to = put_number(to, sequence);
  to = put(to, R"(,"data":{"a":)");
  to = put_number(to, data.a);
  to = put(to, R"(,"b":)");
  to = put_number(to, data.b);
  to = put(to, R"(,"c":)");
  to = put_number(to, data.c);
  to = put(to, R"(,"d":)");
  to = put_number(to, data.d);
  to = put(to, R"(,"e":)");
  to = put_number(to, data.e);
  to = put(to, R"(,"f":)");
  to = put_number(to, data.f);
  to = put(to, R"(,"g":)");
  to = put_number(to, data.g);
  to = put(to, R"(,"h":)");
  to = put_number(to, data.h);
  return put(to, "}}\n");
}

template <class Value>
char* put_raw(char* to, const Value& value) {
  *to++ = sizeof value;
  std::memcpy(to, &value, sizeof value);
  return to + sizeof value;
}

/// The compact wire format of an event.
inline char* raw_by_hand(char* to, std::int64_t time, std::uint64_t, const Eight& data) {
  char* const begin = to;
  to = put(to + 4, "\x0ctest/climate");
  to = put_raw(to, time);
  to = put(to,
           "\x07"
           "chamber");
  to = put_raw(to, data.a);
  to = put_raw(to, data.b);
  to = put_raw(to, data.c);
  to = put_raw(to, data.d);
  to = put_raw(to, data.e);
  to = put_raw(to, data.f);
  to = put_raw(to, data.g);
  to = put_raw(to, data.h);
  const auto size = static_cast<std::uint32_t>(to - begin - 4);
  std::memcpy(begin, &size, sizeof size);
  return to;
}

}  // namespace bench
