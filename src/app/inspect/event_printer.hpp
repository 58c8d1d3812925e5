// Events as readable lines. Private to the program.
#pragma once

#include <cstddef>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

namespace rtdata::app {

/// Makes lines of the JSON that docs/subscribe.md describes:
///
///     2026-11-28 UTC
///     07:51:36.123 room/climate (chamber) temperature=21.5 Cel humidity=40 %
///     07:51:36.900 ! sensor chamber faulted: no answer from the device
///     07:51:37.000 room/climate (chamber) 10 events: temperature=21.4 (21.1 to 21.6) Cel
///
/// A value: any thread may have one.
class EventPrinter {
 public:
  /// `columns`: lines are cut to this many; 0: they are not cut.
  explicit EventPrinter(std::size_t columns) : columns_(columns) {}
  /// The printed text of one line, with its line ends; empty: the line is not shown.
  std::string text(std::string_view json);

 private:
  using Json = nlohmann::ordered_json;
  std::string line_of(const Json& line) const;
  std::string event_text(const Json& line) const;
  std::string unit_of(std::string_view topic, const std::string& path) const;
  void append_value(std::string& text, std::string_view topic, const std::string& path, const Json& value) const;

  std::size_t columns_;
  std::string day_;
  std::map<std::string, std::map<std::string, std::string>, std::less<>> units_;  // by topic and path
};

}  // namespace rtdata::app
