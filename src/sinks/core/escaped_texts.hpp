// Counts and reports a writer's texts that are not UTF-8. Lane's thread.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include "data/utf8.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::detail {

class EscapedTexts {
 public:
  /// How they are stored, for the warning.
  explicit EscapedTexts(const char* fate = "its wrong bytes are written as \\xHH") : fate_(fate) {}
  void begin_batch() { in_batch_.clear(); }
  void add(std::uint32_t slot) { ++in_batch_[slot]; }
  /// Counts those of the payload.
  void look_at(const Record& record) {
    for (const Leaf& leaf : record.info->description->leaves()) {
      if (leaf.kind != Kind::text) continue;
      const std::byte* at = find_value(leaf, record.payload.data());
      if (at != nullptr && !is_readable(text_at(leaf, at))) add(record.slot);
    }
  }
  /// The batch is stored: counts its texts. One that failed comes again, and is not counted before.
  void end_batch(const Batch& batch) {
    for (const auto& [slot, count] : in_batch_) {
      total_ += count;
      if (!known_.insert(slot).second) continue;
      const SlotInfo& info = batch.slot(slot);
      if (!warning_) {
        warning_ = Error{Errc::bad_data, "a text is not UTF-8", "topic " + info.topic + ", origin " + info.origin,
                         fate_, "let the device send UTF-8; of a serial line, check `baud_rate`"};
      } else {
        warning_->where += "; topic " + info.topic + ", origin " + info.origin;
      }
    }
    in_batch_.clear();
  }
  std::uint64_t total() const noexcept { return total_; }
  /// A warning that names the origins whose first such text was stored since the last call.
  std::optional<Error> take_warning() { return std::exchange(warning_, std::nullopt); }

 private:
  const char* fate_;
  std::map<std::uint32_t, std::uint64_t> in_batch_;
  std::set<std::uint32_t> known_;
  std::uint64_t total_ = 0;
  std::optional<Error> warning_;
};

}  // namespace rtdata::detail
