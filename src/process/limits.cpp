#include "rtdata/process/limits.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "data/saturating.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_watch = "cannot watch limits";

/// Above or below; 0: neither.
int side_of(LimitLevel level) noexcept {
  if (level == LimitLevel::unknown) return 0;
  return static_cast<int>(level) > 0 ? 1 : static_cast<int>(level) < 0 ? -1 : 0;
}

}  // namespace

Result<void> check_limits(const LimitSettings& settings) {
  const auto refuse = [](std::string why, std::string advice) {
    return Error{Errc::bad_argument, cannot_watch, "", std::move(why), std::move(advice)};
  };
  const std::array<std::pair<const char*, std::optional<double>>, 4> all{{{"low_low", settings.low_low},
                                                                          {"low", settings.low},
                                                                          {"high", settings.high},
                                                                          {"high_high", settings.high_high}}};
  const std::pair<const char*, std::optional<double>>* before = nullptr;
  for (const auto& one : all) {
    if (!one.second) continue;
    if (!std::isfinite(*one.second)) return refuse(std::string("`") + one.first + "` is not finite", "give a number");
    if (before != nullptr && !(*before->second < *one.second))
      return refuse(std::string("`") + before->first + "` is not less than `" + one.first + "`",
                    "choose them so that low_low < low < high < high_high");
    before = &one;
  }
  if (before == nullptr) return refuse("there is no limit", "give `low_low`, `low`, `high` or `high_high`");
  if (!(settings.hysteresis >= 0) || !std::isfinite(settings.hysteresis))
    return refuse("`hysteresis` must be 0 or more", "set it a little larger than the noise of the value");
  const auto lower = settings.low ? settings.low : settings.low_low;
  const auto upper = settings.high ? settings.high : settings.high_high;
  if (lower && upper && settings.hysteresis >= *upper - *lower)
    return refuse(
        "`hysteresis` is as large as the distance between the limits: the value could never become normal again",
        "set it a little larger than the noise of the value");
  if (settings.delay < Duration{0}) return refuse("`delay` is negative", "set it to 0 or more");
  return {};
}

LimitWatch::LimitWatch(const LimitSettings& settings)
    : limits_{{{{}, 1, LimitLevel::high_high},
               {{}, 1, LimitLevel::high},
               {{}, -1, LimitLevel::low_low},
               {{}, -1, LimitLevel::low}}} {
  change(settings);
}

void LimitWatch::change(const LimitSettings& settings) {
  check_limits(settings).or_throw();
  const std::optional<double> all[] = {settings.high_high, settings.high, settings.low_low, settings.low};
  for (std::size_t i = 0; i < limits_.size(); ++i) {
    limits_[i].at = all[i];
    if (all[i]) continue;
    limits_[i].is_passed = false;
    limits_[i].beyond_since.reset();
  }
  hysteresis_ = settings.hysteresis;
  delay_ = settings.delay;
  is_latched_ = settings.latched;
  state_.limit = limit_of(state_.alarm);
  forget_same();
}

bool LimitWatch::take(double value, Time time) noexcept {
  if (value > same_from_ && value < same_until_) {
    state_.value = value;
    return false;
  }
  if (!std::isfinite(value)) return take_unknown();
  state_.value = value;
  LimitLevel level = LimitLevel::normal;
  for (Limit& limit : limits_) {
    if (!limit.at) continue;
    const double beyond = (value - *limit.at) * limit.side;
    if (limit.is_passed) {
      if (beyond <= -hysteresis_) limit.is_passed = false;
    }
    if (!limit.is_passed) {
      if (!(beyond > 0)) {
        limit.beyond_since.reset();
      } else {
        if (!limit.beyond_since) limit.beyond_since = time;
        limit.is_passed = detail::span_between(*limit.beyond_since, time) >= delay_;
      }
    }
    if (limit.is_passed && level == LimitLevel::normal) level = limit.level;
  }
  forget_same();
  const bool has_changed = change_to(level);
  if (state_.level == state_.alarm) find_same();
  return has_changed;
}

void LimitWatch::find_same() noexcept {
  same_from_ = -std::numeric_limits<double>::infinity();
  same_until_ = std::numeric_limits<double>::infinity();
  for (const Limit& limit : limits_) {
    if (!limit.at) continue;
    if (!limit.is_passed && limit.beyond_since) return forget_same();  // the delay runs
    // If passed, the limit minus the hysteresis, with a small margin for rounding; otherwise the limit.
    const double rounding = (std::abs(*limit.at) + hysteresis_) * 1e-12;
    const double edge = limit.is_passed ? *limit.at - limit.side * (hysteresis_ - rounding) : *limit.at;
    const bool is_below = (limit.side > 0) == !limit.is_passed;
    if (is_below)
      same_until_ = std::min(same_until_, edge);
    else
      same_from_ = std::max(same_from_, edge);
  }
}

void LimitWatch::forget_same() noexcept { same_from_ = same_until_ = 0; }

bool LimitWatch::take_unknown() noexcept {
  forget_same();
  state_.value.reset();
  for (Limit& limit : limits_) limit.beyond_since.reset();  // an unknown value restarts the delay
  return change_to(LimitLevel::unknown);
}

bool LimitWatch::change_to(LimitLevel level) noexcept {
  const LimitState before = state_;
  state_.level = level;
  const bool is_new = severity(level) > severity(state_.alarm) ||
                      (side_of(level) != 0 && side_of(level) != side_of(state_.alarm) &&
                       severity(level) == severity(state_.alarm)) ||
                      (state_.alarm == LimitLevel::unknown && side_of(level) != 0);
  if (is_new) {
    state_.alarm = level;
    state_.acknowledged = false;
  } else if (level != LimitLevel::unknown && (!is_latched_ || state_.acknowledged)) {
    state_.alarm = level;
    state_.acknowledged = state_.acknowledged || level == LimitLevel::normal;
  } else if (level == LimitLevel::normal && state_.alarm == LimitLevel::unknown) {
    state_.alarm = level;
    state_.acknowledged = true;
  }
  state_.limit = limit_of(state_.alarm);
  return state_.level != before.level || state_.alarm != before.alarm || state_.acknowledged != before.acknowledged;
}

bool LimitWatch::acknowledge() noexcept {
  if (state_.acknowledged) return false;
  forget_same();
  state_.acknowledged = true;
  if (state_.level != LimitLevel::unknown) {
    state_.alarm = state_.level;
    state_.limit = limit_of(state_.alarm);
  }
  return true;
}

void LimitWatch::reset() noexcept {
  forget_same();
  state_ = {};
  for (Limit& limit : limits_) {
    limit.is_passed = false;
    limit.beyond_since.reset();
  }
}

std::optional<double> LimitWatch::limit_of(LimitLevel level) const noexcept {
  for (const Limit& limit : limits_)
    if (limit.level == level) return limit.at;
  return std::nullopt;
}

}  // namespace rtdata
