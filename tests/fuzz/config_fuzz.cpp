/// Any bytes as a configuration: reading, writing, asking and reporting must neither crash nor disagree.
///
///     tests/fuzz/run.sh 60
#include <array>
#include <cstdint>
#include <cstdlib>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/config/format.hpp"
#include "rtdata/config/read.hpp"

namespace {

using namespace rtdata;

struct Inner {
  int size = 5;
  std::optional<double> limit;
  friend constexpr auto parameters(type_tag<Inner>) {
    return parameter_list(parameter("size", &Inner::size, "samples", range(1, 99)),
                          parameter("limit", &Inner::limit, "largest step"));
  }
};

struct Config {
  std::string name;
  std::chrono::milliseconds timeout{10};
  Rate rate;
  char separator = ',';
  std::array<float, 2> pair{};
  std::vector<Inner> list;
  std::map<std::string, std::uint8_t> map;
  std::string choice = "a";
  friend constexpr auto parameters(type_tag<Config>) {
    return parameter_list(
        parameter("name", &Config::name, "name", required),
        parameter("timeout", &Config::timeout, "wait", may_be_negative), parameter("rate", &Config::rate, "rate"),
        parameter("separator", &Config::separator, "character"), parameter("pair", &Config::pair, "two", range(0, 1)),
        parameter("list", &Config::list, "list"), parameter("map", &Config::map, "map"),
        parameter("choice", &Config::choice, "choice", choices("a", "b")));
  }
};

void check(bool holds) {
  if (!holds) std::abort();
}

/// Every item is found under its own path, and has a place in the file.
void walk(const ConfigItem& root, const ConfigItem& item) {
  const std::string path = item.path();
  check(item.place().line > 0 && item.place().column > 0);
  check(path.empty() || path.size() > 200 || root.find(path) != nullptr);
  for (const auto& [key, child] : item.children()) walk(root, child);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const ConfigDocument document = parse_config(text, "fuzz.json");
  check(document.good() == document.report().empty());
  if (!document.good()) return 0;
  walk(document.root, document.root);
  check(parse_config(document.root.to_json(ConfigItem::Layout::one_line)).or_throw() == document.root);
  Config config;
  Problems problems;
  if (read_config(document.root, config, problems)) {
    Config again;
    check(read_config(write_config(config), again, problems));
    check(write_config(again) == write_config(config));
  } else {
    check(!problems.empty() && !problems.text().empty());
  }
  return 0;
}
