#include "process/processor.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

#include "data/field_layout.hpp"
#include "data/fnv.hpp"
#include "data/load.hpp"
#include "data/saturating.hpp"
#include "process/published.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/process/processing.hpp"

namespace rtdata::detail {
namespace {

/// True if both have the same steps; their constants may differ.
bool has_same_steps(const FieldProcessing& a, const FieldProcessing& b) noexcept {
  if (a.calibration.has_value() != b.calibration.has_value() || a.filters.size() != b.filters.size()) return false;
  const auto has_bounds = [](const Calibration& c) { return c.least || c.most; };
  if (a.calibration &&
      (a.calibration->polynomial.size() != b.calibration->polynomial.size() ||
       a.calibration->table.size() != b.calibration->table.size() ||
       a.calibration->points.empty() != b.calibration->points.empty() ||
       (a.calibration->tare == 0) != (b.calibration->tare == 0) || a.calibration->outside != b.calibration->outside ||
       has_bounds(*a.calibration) != has_bounds(*b.calibration)))
    return false;
  return std::equal(a.filters.begin(), a.filters.end(), b.filters.begin(), [](const Filter& f, const Filter& g) {
    return f.type == g.type && f.of == g.of && f.time == g.time;
  });
}

std::size_t extent(const Leaf& leaf) noexcept { return leaf.size + (leaf.optional != nullptr ? 1 : 0); }

}  // namespace

Processor::Processor(std::shared_ptr<const Description> source, const Processing& processing, const std::string& sensor)
    : source_(std::move(source)), published_(processed(source_, processing, sensor)) {
  if (published_ != source_) {
    payload_.resize(published_->size() + published_->alignment());
    const auto address = reinterpret_cast<std::uintptr_t>(payload_.data());
    shift_ = (published_->alignment() - address % published_->alignment()) % published_->alignment();
    out_ = payload_.data() + shift_;
    plan_copies();
  }
  std::vector<std::vector<Item>> groups;
  for (const auto& entry : processing) {
    const std::string& path = entry.first;
    const FieldProcessing& what = entry.second;
    for (const Leaf* leaf : leaves_of(*source_, path)) {
      const auto alike = std::find_if(groups.begin(), groups.end(), [&](const std::vector<Item>& group) {
        const Leaf& first = *group.front().leaf;
        return first.kind == leaf->kind && first.optional == nullptr && leaf->optional == nullptr &&
               has_same_steps(*group.front().what, what);
      });
      if (alike != groups.end()) {
        alike->push_back({leaf, &path, &what});
      } else {
        groups.push_back({{leaf, &path, &what}});
      }
    }
  }
  for (const auto& group : groups) add_group(group);
}

/// Values whose type stays; runs of them as one.
void Processor::plan_copies() {
  for (std::size_t i = 0; i < source_->leaves().size(); ++i) {
    const Leaf& from = source_->leaves()[i];
    const Leaf& to = published_->leaves()[i];  // added fields come after those of the source
    if (from.kind == to.kind) add_copy(from, to);
  }
}

void Processor::add_copy(const Leaf& from, const Leaf& to) {
  if (!copies_.empty()) {
    Copy& last = copies_.back();
    if (from.offset >= last.from + last.size && from.offset - last.from == to.offset - last.to) {
      last.size = from.offset - last.from + extent(from);
      return;
    }
  }
  copies_.push_back({from.offset, to.offset, extent(from)});
}

Processor::Op& Processor::add_op(OpKind step, std::size_t numbers) {
  Op& op = ops_.emplace_back();
  op.step = step;
  op.first = numbers_.size();
  numbers_.resize(numbers_.size() + numbers);
  return op;
}

void Processor::add_group(const std::vector<Item>& items) {
  Group& group = groups_.emplace_back();
  const Leaf& first = *items.front().leaf;
  const FieldProcessing& steps = *items.front().what;
  const std::size_t lanes = items.size();
  group.from = first.kind;
  group.from_optional = first.optional;
  group.is_written = changes_value(steps);
  group.first = lanes_.size();
  group.count = lanes;
  group.first_op = ops_.size();
  for (const Item& item : items) {
    Lane& lane = lanes_.emplace_back();
    lane.leaf = static_cast<std::size_t>(item.leaf - source_->leaves().data());
    lane.from = item.leaf->offset;
    const std::string element = item.leaf->path.substr(item.path->size());
    if (group.is_written) {
      const Leaf& to = published_->leaves()[lane.leaf];
      group.to = to.kind;
      group.to_optional = to.optional;
      lane.to = to.offset;
      add_copy(*item.leaf, *published_->find(*item.path + ".raw" + element));
    }
    if (has_rate(steps)) {
      const Leaf& rate = *published_->find(*item.path + ".rate" + element);
      group.rate_optional = rate.optional;
      lane.rate = rate.offset;
    }
  }
  const auto are_row = [&](Kind kind, std::size_t Lane::*offset) {
    bool is_row = kind == Kind::f64;
    for (std::size_t i = 1; i < lanes; ++i)
      is_row = is_row && lanes_[group.first + i].*offset == lanes_[group.first].*offset + i * sizeof(double);
    return is_row;
  };
  group.from_is_row = are_row(group.from, &Lane::from);
  group.to_is_row = are_row(group.to, &Lane::to);
  // A number of each value, one row after the other.
  const auto row = [&](const Op& op, std::size_t number, const auto& of) {
    for (std::size_t i = 0; i < lanes; ++i) numbers_[op.first + number * lanes + i] = of(*items[i].what);
  };
  if (steps.calibration) {
    const Calibration& c = *steps.calibration;
    if (c.points.empty()) {
      const Op scale = add_op(OpKind::scale, 2 * lanes);
      row(scale, 0, [](const FieldProcessing& what) { return what.calibration->scale; });
      row(scale, 1, [](const FieldProcessing& what) { return what.calibration->offset; });
    } else {
      const Op op = add_op(OpKind::line, 3 * lanes);
      row(op, 0, [](const FieldProcessing& what) { return line_through(what.calibration->points).slope; });
      row(op, 1, [](const FieldProcessing& what) { return line_through(what.calibration->points).x; });
      row(op, 2, [](const FieldProcessing& what) { return line_through(what.calibration->points).y; });
    }
    if (!c.polynomial.empty()) {
      Op& op = add_op(OpKind::polynomial, c.polynomial.size() * lanes);
      op.count = static_cast<std::uint32_t>(c.polynomial.size());
      for (std::size_t n = 0; n < op.count; ++n)
        row(op, n, [&](const FieldProcessing& what) { return what.calibration->polynomial[op.count - 1 - n]; });
    }
    if (!c.table.empty()) {
      Op& op = add_op(OpKind::table, 2 * c.table.size() * lanes);
      op.count = static_cast<std::uint32_t>(c.table.size());
      op.outside = c.outside;
      double* to = numbers_.data() + op.first;  // of each value all x, then all y
      for (const Item& item : items) {
        for (const std::size_t part : {std::size_t{0}, std::size_t{1}})
          for (const auto& point : item.what->calibration->table) *to++ = point[part];
      }
    }
    if (c.least || c.most) {
      const Op op = add_op(OpKind::bounds, 2 * lanes);
      row(op, 0, [](const FieldProcessing& what) { return what.calibration->least.value_or(-HUGE_VAL); });
      row(op, 1, [](const FieldProcessing& what) { return what.calibration->most.value_or(HUGE_VAL); });
    }
    if (c.tare != 0)
      row(add_op(OpKind::tare, lanes), 0, [](const FieldProcessing& what) { return what.calibration->tare; });
  }
  for (std::size_t n = 0; n < steps.filters.size(); ++n) {
    const Filter& filter = steps.filters[n];
    const std::uint32_t of = filter.of.value_or(0);
    switch (filter.type) {
      case FilterType::median:  // the samples as they came, and in order
        add_op(OpKind::median, 2 * of * lanes).count = of;
        break;
      case FilterType::mean:  // sums, and that of the samples since the beginning of the round
        add_op(OpKind::mean, (of + std::size_t{1}) * lanes).count = of;
        break;
      case FilterType::exponential:
        row(add_op(OpKind::exponential, 2 * lanes), 0,
            [&](const FieldProcessing& what) { return *what.filters[n].weight; });
        break;
      case FilterType::clamp: {
        const Op op = add_op(OpKind::clamp, 2 * lanes);
        row(op, 0, [&](const FieldProcessing& what) { return what.filters[n].least.value_or(-HUGE_VAL); });
        row(op, 1, [&](const FieldProcessing& what) { return what.filters[n].most.value_or(HUGE_VAL); });
        break;
      }
      case FilterType::throttle:
        add_op(OpKind::throttle, 0).time = *filter.time;
        group.decides = true;
        break;
      case FilterType::delta:  // by how much, what was published last, what there is now
        row(add_op(OpKind::delta, 3 * lanes), 0, [&](const FieldProcessing& what) { return *what.filters[n].by; });
        group.decides = true;
        break;
      case FilterType::rate_of_change:
        add_op(OpKind::rate, 2 * lanes);  // of the last instant, and of the one before
        break;
    }
  }
  group.end_op = ops_.size();
  decides_ = decides_ || group.decides;
  x_.resize(std::max(x_.size(), lanes));
  passes_.resize(x_.size());
}

void Processor::restart() noexcept {
  for (Op& op : ops_) {
    op.filled = 0;
    op.at = 0;
    op.reference = Reference::none;
  }
}

Processor::Fate Processor::take(void*& payload, Time time, std::uint64_t breaks) noexcept {
  if (breaks != breaks_ || time < last_time_) restart();
  breaks_ = breaks;
  last_time_ = time;
  if (instant_ > time || span_between(instant_, time) >= one_instant) instant_ = time;
  const auto* const from = static_cast<const std::byte*>(payload);
  for (const Copy& copy : copies_) std::memcpy(out_ + copy.to, from + copy.from, copy.size);
  bool is_wanted = !decides_;
  for (Group& group : groups_) {
    if (group.from_optional != nullptr && !group.from_optional->has_value(from + lanes_[group.first].from)) {
      pass_absent(group, is_wanted);
    } else if (!run(group, from, time, is_wanted)) {
      const std::byte* const raw = from + source_->leaves()[failed_leaf_].offset;
      for_number(group.from, [&]<class T>(T value) {
        std::memcpy(&value, raw, sizeof value);
        if (std::isfinite(static_cast<double>(value))) return;
        failure_ = Failure::raw_not_finite;
        failed_value_ = static_cast<double>(value);
      });
      return Fate::unusable;
    }
  }
  if (!is_wanted) return Fate::filtered;
  if (decides_) {
    for (const Group& group : groups_) {
      for (std::size_t i = group.first_op; i < group.end_op; ++i) {
        Op& op = ops_[i];
        if (op.step != OpKind::throttle && op.step != OpKind::delta) continue;
        op.last_time = time;
        op.reference = op.is_absent ? Reference::absent : Reference::value;
        double* const by = numbers_.data() + op.first;
        if (op.step == OpKind::delta) std::copy_n(by + 2 * group.count, group.count, by + group.count);
      }
    }
  }
  if (out_ != nullptr) payload = out_;
  return Fate::published;
}

bool Processor::fail(const Group& group, std::size_t lane, Failure failure, double value, double bound) noexcept {
  failed_leaf_ = lanes_[group.first + lane].leaf;
  failure_ = failure;
  failed_value_ = value;
  failed_bound_ = bound;
  return false;
}

bool Processor::check_finite(const Group& group) noexcept {
  const double* const x = x_.data();
  bool are_finite = true;
  for (std::size_t i = 0; i < group.count; ++i) are_finite &= std::abs(x[i]) <= std::numeric_limits<double>::max();
  if (are_finite) [[likely]]
    return true;
  std::size_t lane = 0;
  while (std::isfinite(x[lane])) ++lane;
  return fail(group, lane, Failure::not_finite, x[lane]);
}

bool Processor::run(Group& group, const std::byte* payload, Time time, bool& is_wanted) noexcept {
  const std::size_t lanes = group.count;
  const Lane* const lane = lanes_.data() + group.first;
  double* const x = x_.data();
  if (group.from_is_row) {
    std::memcpy(x, payload + lane->from, lanes * sizeof *x);
  } else {
    for_number(group.from, [&]<class T>(T value) {
      for (std::size_t i = 0; i < lanes; ++i) {
        std::memcpy(&value, payload + lane[i].from, sizeof value);
        x[i] = static_cast<double>(value);
      }
    });
  }
  if (group.decides) std::fill_n(passes_.begin(), lanes, std::uint8_t{1});
  bool is_finite = is_integer_kind(group.from);  // an integer cannot have become infinite or NaN
  const auto look = [&] { return std::exchange(is_finite, true) || check_finite(group); };
  const Op* const end = ops_.data() + group.end_op;
  for (Op* op = ops_.data() + group.first_op; op != end; ++op) {
    double* const a = numbers_.data() + op->first;
    double* const b = a == nullptr ? nullptr : a + lanes;  // null: no step has numbers
    switch (op->step) {
      case OpKind::scale:
        for (std::size_t i = 0; i < lanes; ++i) x[i] = x[i] * a[i] + b[i];
        is_finite = false;
        break;
      case OpKind::line:
        for (std::size_t i = 0; i < lanes; ++i) x[i] = (x[i] - b[i]) * a[i] + b[lanes + i];
        is_finite = false;
        break;
      case OpKind::tare:
        for (std::size_t i = 0; i < lanes; ++i) x[i] -= a[i];
        is_finite = false;
        break;
      case OpKind::polynomial:
        for (std::size_t i = 0; i < lanes; ++i) {
          double sum = a[i];
          for (std::size_t n = 1; n < op->count; ++n) sum = sum * x[i] + a[n * lanes + i];
          x[i] = sum;
        }
        is_finite = false;
        break;
      case OpKind::table:
        if (!look() || !look_up(group, *op)) return false;
        is_finite = false;
        break;
      case OpKind::bounds:
        if (!check_bounds(group, *op)) return false;
        break;
      case OpKind::median:
        if (!look()) return false;
        take_medians(lanes, *op);
        break;
      case OpKind::mean:
        take_means(lanes, *op);
        is_finite = false;
        break;
      case OpKind::exponential:
        if (std::exchange(op->filled, 1) == 0) std::copy_n(x, lanes, b);
        for (std::size_t i = 0; i < lanes; ++i) x[i] = b[i] += a[i] * (x[i] - b[i]);
        is_finite = false;
        break;
      case OpKind::clamp:
        if (!look()) return false;
        for (std::size_t i = 0; i < lanes; ++i) x[i] = std::min(std::max(x[i], a[i]), b[i]);
        break;
      case OpKind::throttle:
        op->is_absent = false;
        if (op->reference != Reference::none && span_between(op->last_time, time) < op->time)
          std::fill_n(passes_.begin(), lanes, std::uint8_t{0});
        break;
      case OpKind::delta:
        op->is_absent = false;
        std::copy_n(x, lanes, b + lanes);
        for (std::size_t i = 0; op->reference == Reference::value && i < lanes; ++i)
          if (std::abs(x[i] - b[i]) < a[i]) passes_[i] = 0;
        break;
      case OpKind::rate:
        if (!put_rates(group, *op)) return false;
        break;
    }
  }
  if (!look()) return false;
  if (group.decides)
    is_wanted = is_wanted || std::find(passes_.begin(), passes_.begin() + std::ptrdiff_t(lanes), 1) !=
                                 passes_.begin() + std::ptrdiff_t(lanes);
  return !group.is_written || put(group);
}

bool Processor::put(const Group& group) noexcept {
  const Lane* const lane = lanes_.data() + group.first;
  const double* const x = x_.data();
  if (group.to == Kind::f32) {
    for (std::size_t i = 0; i < group.count; ++i) {
      const auto value = static_cast<float>(x[i]);
      if (!std::isfinite(value)) return fail(group, i, Failure::not_finite, x[i]);
      std::memcpy(out_ + lane[i].to, &value, sizeof value);
    }
  } else if (group.to_is_row) {
    std::memcpy(out_ + lane->to, x, group.count * sizeof *x);
  } else {
    for (std::size_t i = 0; i < group.count; ++i) std::memcpy(out_ + lane[i].to, x + i, sizeof *x);
  }
  if (group.to_optional != nullptr) out_[lane->to + group.to_optional->value_size] = std::byte{1};
  return true;
}

/// Handles an absent value: its filters restart, and the absence counts as a change.
void Processor::pass_absent(Group& group, bool& is_wanted) noexcept {
  const Lane& lane = lanes_[group.first];
  if (group.is_written) group.to_optional->set(out_ + lane.to, false);
  if (group.rate_optional != nullptr) group.rate_optional->set(out_ + lane.rate, false);
  bool passes = group.decides;
  for (std::size_t i = group.first_op; i < group.end_op; ++i) {
    Op& op = ops_[i];
    if (op.step == OpKind::throttle) {
      op.is_absent = false;
      passes = passes && (op.reference == Reference::none || span_between(op.last_time, last_time_) >= op.time);
    } else if (op.step == OpKind::delta) {
      op.is_absent = true;
      passes = passes && op.reference != Reference::absent;
    } else {
      op.filled = 0;
      op.at = 0;
    }
  }
  is_wanted = is_wanted || passes;
}

bool Processor::look_up(const Group& group, Op& op) noexcept {
  for (std::size_t i = 0; i < group.count; ++i) {
    const double* const xs = numbers_.data() + op.first + 2 * i * op.count;
    const double* const ys = xs + op.count;
    double& x = x_[i];
    if (!(x >= xs[0] && x <= xs[op.count - 1]) && op.outside != OutsideTable::extend) {
      if (op.outside == OutsideTable::refuse) return fail(group, i, Failure::outside_table, x);
      x = x < xs[0] ? ys[0] : ys[op.count - 1];
      continue;
    }
    const double* const above = std::upper_bound(xs + 1, xs + op.count - 1, x);
    const auto n = static_cast<std::size_t>(above - xs) - 1;
    x = ys[n] + (ys[n + 1] - ys[n]) * ((x - xs[n]) / (xs[n + 1] - xs[n]));
  }
  return true;
}

bool Processor::check_bounds(const Group& group, const Op& op) noexcept {
  const double* const least = numbers_.data() + op.first;
  const double* const most = least + group.count;
  for (std::size_t i = 0; i < group.count; ++i) {
    if (x_[i] < least[i]) return fail(group, i, Failure::below, x_[i], least[i]);
    if (x_[i] > most[i]) return fail(group, i, Failure::above, x_[i], most[i]);
  }
  return true;
}

void Processor::take_medians(std::size_t lanes, Op& op) noexcept {
  double* const x = x_.data();
  double* const came = numbers_.data() + op.first;
  double* const newest = came + op.at * lanes;
  if (op.count == 5 && op.filled >= 4) {  // without a branch, and so side by side
    op.filled = 5;
    std::copy_n(x, lanes, newest);
    const auto sort = [](double& low, double& high) {
      const double least = std::min(low, high);
      high = std::max(low, high);
      low = least;
    };
    for (std::size_t i = 0; i < lanes; ++i) {
      double a = came[i], b = came[lanes + i], c = came[2 * lanes + i], d = came[3 * lanes + i];
      sort(a, b);
      sort(c, d);
      sort(a, c);  // now a is below the middle
      sort(b, d);  // and d above it
      sort(b, c);
      x[i] = std::max(b, std::min(c, came[4 * lanes + i]));
    }
  } else {
    const std::uint32_t filled = std::min(op.filled + 1, op.count);
    for (std::size_t i = 0; i < lanes; ++i) {
      double* const sorted = came + op.count * lanes + i * op.count;
      std::uint32_t n = filled - 1;  // the free place in the order
      if (op.filled == op.count)
        for (n = 0; sorted[n] != newest[i];) ++n;
      for (; n + 1 < filled && sorted[n + 1] < x[i]; ++n) sorted[n] = sorted[n + 1];
      for (; n > 0 && sorted[n - 1] > x[i]; --n) sorted[n] = sorted[n - 1];
      sorted[n] = x[i];
      newest[i] = x[i];
      const std::uint32_t middle = filled / 2;
      x[i] = filled % 2 == 1 ? sorted[middle] : sorted[middle - 1] / 2 + sorted[middle] / 2;
    }
    op.filled = filled;
  }
  op.at = op.at + 1 == op.count ? 0 : op.at + 1;
}

/// Sums only values in the window, so that no rounding errors of old large values remain: the values since the
/// beginning of a round, and, for each place, the sum from there to the end of the previous round.
void Processor::take_means(std::size_t lanes, Op& op) noexcept {
  double* const x = x_.data();
  double* const sums = numbers_.data() + op.first;
  double* const since = sums + op.count * lanes;
  if (op.at == op.count) {
    for (std::size_t n = (op.count - 1) * lanes; n > 0; --n) sums[n - 1] += sums[n - 1 + lanes];
    op.at = 0;
  }
  double* const newest = sums + op.at * lanes;
  for (std::size_t i = 0; i < lanes; ++i) {
    since[i] = op.at == 0 ? x[i] : since[i] + x[i];
    newest[i] = x[i];
  }
  ++op.at;
  if (op.filled < op.count) ++op.filled;
  const bool is_across = op.filled == op.count && op.at < op.count;
  for (std::size_t i = 0; i < lanes; ++i)
    x[i] = (is_across ? since[i] + sums[op.at * lanes + i] : since[i]) / op.filled;
}

/// Since the previous instant, which is represented by its last value.
bool Processor::put_rates(const Group& group, Op& op) noexcept {
  double* const last = numbers_.data() + op.first;
  double* const before = last + group.count;
  const bool is_new = op.filled == 0 || instant_ > op.last_time;
  const bool is_known = op.filled > (is_new ? 0U : 1U);
  const double* const from = is_new ? last : before;
  const Duration passed = is_known ? span_between(is_new ? op.last_time : op.time_before, instant_) : Duration{0};
  for (std::size_t i = 0; i < group.count; ++i) {
    std::byte* const at = out_ + lanes_[group.first + i].rate;
    if (group.rate_optional->set(at, is_known) == nullptr) continue;
    const double rate = (x_[i] - from[i]) / (static_cast<double>(passed.count()) * 1e-9);
    if (!std::isfinite(rate)) return fail(group, i, Failure::not_finite, x_[i]);
    std::memcpy(at, &rate, sizeof rate);
  }
  if (is_new) {
    std::copy_n(last, group.count, before);
    op.time_before = op.last_time;
    op.last_time = instant_;
    op.filled = std::min(op.filled + 1, 2U);
  }
  std::copy_n(x_.data(), group.count, last);
  return true;
}

Error Processor::error(const std::string& sensor) const {
  const std::string value = to_string(Value(failed_value_));
  const std::string bound = to_string(Value(failed_bound_));
  Error error{Errc::out_of_range, "cannot use a value",
              "sensor " + sensor + ", field " + source_->leaves()[failed_leaf_].path, "", ""};
  switch (failure_) {
    case Failure::raw_not_finite:
      error.why = "it is " + value;
      error.advice = "check the sensor: only finite numbers can be calibrated or filtered";
      break;
    case Failure::not_finite:
      error.why = "after calibration and filters, it is not a finite number";
      error.advice = "check its calibration";
      break;
    case Failure::outside_table:
      error.why = value + " is outside the table of its calibration";
      error.advice =
          "extend the table, or set `outside`: \"extend\" continues the last line, \"clamp\" keeps the last value";
      break;
    case Failure::below:
      error.why = value + " is below " + bound + " (`least`)";
      error.advice = "check the sensor, or `least` of its calibration";
      break;
    case Failure::above:
      error.why = value + " is above " + bound + " (`most`)";
      error.advice = "check the sensor, or `most` of its calibration";
      break;
  }
  return error;
}

namespace {

const char* name_of(FilterType type) noexcept {
  constexpr auto filter = parameters(type_tag<Filter>{});
  const auto& choices = filter.entries[0].rules.choices;
  for (std::size_t i = choices.first; i < choices.first + choices.count; ++i)
    if (filter.words[i].value == static_cast<std::int64_t>(type)) return filter.words[i].text.data();
  return "";
}

template <class T>
void set_if(ConfigItem& item, std::string_view key, const std::optional<T>& value) {
  if (value) item.set(key, *value);
}

ConfigItem item_of(const Calibration& c) {
  ConfigItem item = ConfigItem::object();
  if (c.scale != 1) item.set("scale", c.scale);
  if (c.offset != 0) item.set("offset", c.offset);
  if (!c.polynomial.empty()) item.set("polynomial", c.polynomial);
  if (!c.table.empty()) item.set("table", c.table);
  if (!c.points.empty()) item.set("points", c.points);
  if (c.tare != 0) item.set("tare", c.tare);
  if (c.outside != OutsideTable::refuse) item.set("outside", c.outside == OutsideTable::clamp ? "clamp" : "extend");
  set_if(item, "least", c.least);
  set_if(item, "most", c.most);
  return item;
}

ConfigItem item_of(const Filter& f) {
  ConfigItem item = ConfigItem::object();
  item.set("type", name_of(f.type));
  set_if(item, "of", f.of);
  set_if(item, "weight", f.weight);
  set_if(item, "least", f.least);
  set_if(item, "most", f.most);
  set_if(item, "time", f.time);
  set_if(item, "by", f.by);
  return item;
}

std::string version_of(std::string_view text) {
  const std::uint64_t hash = detail::fnv1a(text);
  std::string version;
  for (int shift = 28; shift >= 0; shift -= 4) version += "0123456789abcdef"[hash >> shift & 15];
  return version;
}

}  // namespace

std::string text_of(const Processing& processing, std::string_view topic) {
  ConfigItem fields = ConfigItem::object();
  for (const auto& [path, what] : processing) {
    ConfigItem field = ConfigItem::object();
    if (what.calibration) {
      const ConfigItem calibration = item_of(*what.calibration);
      field.set("version",
                what.calibration->version.empty()
                    ? version_of(calibration.to_json(ConfigItem::Layout::one_line))
                    : what.calibration->version + (what.calibration->tare == 0
                                                       ? std::string()
                                                       : ", tare " + to_string(Value(what.calibration->tare))));
      field.set("calibration", calibration);
    }
    if (!what.filters.empty()) field.set("filters", ConfigItem::array());
    for (const Filter& filter : what.filters) field.find("filters")->push_back(item_of(filter));
    set_if(field, "unit", what.unit);
    fields.set(path, field);
  }
  ConfigItem all = ConfigItem::object();
  all.set("topic", topic);
  all.set("fields", fields);
  return all.to_json(ConfigItem::Layout::one_line);
}

}  // namespace rtdata::detail
