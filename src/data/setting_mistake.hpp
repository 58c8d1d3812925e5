// Settings that cannot work: check_config reports them, a constructor throws the first.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/problem.hpp"

namespace rtdata::detail {

struct SettingMistake {
  std::string key = {};  // "url", "tls.key"
  std::string why = {};  // empty: there is no mistake
  std::string advice = {};

  explicit operator bool() const noexcept { return !why.empty(); }
  SetupError error(const char* what) const { return SetupError({Errc::bad_argument, what, key, why, advice}); }
};

/// The item at this path, or the nearest one that contains it.
inline const ConfigItem& item_of(const ConfigItem& item, std::string_view path) {
  while (!path.empty()) {
    if (const ConfigItem* found = item.find(path)) return *found;
    const std::size_t last = path.find_last_of(".[");
    path = path.substr(0, last == std::string_view::npos ? 0 : last);
  }
  return item;
}

/// `id_if_missing`: the id of the problem if there is no item with the key.
inline void add_mistake(const SettingMistake& mistake, const ConfigItem& item, Problems& problems,
                        const char* id_if_missing = "bad-value") {
  if (!mistake) return;
  problems.add(item_of(item, mistake.key)
                   .problem(item.find(mistake.key) != nullptr ? "bad-value" : id_if_missing,
                            mistake.advice.empty() ? mistake.why : mistake.why + "; " + mistake.advice));
}
inline void add_mistakes(const std::vector<SettingMistake>& mistakes, const ConfigItem& item, Problems& problems) {
  for (const SettingMistake& mistake : mistakes) add_mistake(mistake, item, problems);
}

}  // namespace rtdata::detail
