#include "rtdata/config/system.hpp"

#include "config/read/mistakes.hpp"

namespace rtdata {

using config_detail::child_or_self;

void check_config(const LogSettings& settings, const ConfigItem& item, Problems& problems) {
  if (settings.max_bytes == 0 || settings.max_bytes >= 4096) return;
  problems.add(
      child_or_self(item, "max_bytes")
          .problem("out-of-range", std::to_string(settings.max_bytes) + " is out of range: give 4096 at least, or 0"));
}

void check_config(const TierSettings& settings, const ConfigItem& item, Problems& problems) {
  const auto complain = [&](const char* key, std::string message) {
    problems.add(child_or_self(item, key).problem("bad-value", std::move(message)));
  };
  if (settings.cpu && !settings.cpus.empty()) complain("cpu", "give `cpu` or `cpus`, not both");
  const bool is_real_time = settings.policy != SchedulingPolicy::other;
  if (is_real_time && settings.priority == 0) {
    complain("policy", "policy \"" + std::string(name_of(settings.policy)) + "\" needs a `priority` from 1 to 99");
  } else if (!is_real_time && settings.priority != 0) {
    complain("priority", "only the policies \"fifo\" and \"rr\" have a priority");
  }
}

Tier::Config TierSettings::tier_config(const std::string& tier_name) const {
  Tier::Config config = *this;
  config.name = tier_name;
  if (cpu) config.cpus.push_back(*cpu);
  return config;
}

}  // namespace rtdata
