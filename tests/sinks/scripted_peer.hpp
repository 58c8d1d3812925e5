/// A sender whose peer does what a test tells it, without a network.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/data/value.hpp"
#include "rtdata/sinks/sender.hpp"

namespace sinks {

inline const rtdata::Error away{rtdata::Errc::io_failed, "cannot send", "peer", "it is away", ""};

class ScriptedPeer final : public rtdata::Sender {
 public:
  struct Event {
    std::string run, topic, origin;
    std::uint64_t sequence = 0;
    rtdata::Time time{};
    bool operator==(const Event&) const = default;
  };
  /// Shared with the test; of the loop's thread.
  struct Script {
    rtdata::SendingConfig sending = {.window = 2, .parcel_rows = 10, .timeout = std::chrono::seconds{1}};
    /// What becomes of a parcel; none: it is acknowledged at once.
    std::function<void(const rtdata::Parcel& parcel, rtdata::Answer answer)> on_send;
    std::function<void()> on_begin;
    std::vector<Event> events;  // that were acknowledged by `take`
    std::vector<rtdata::Answer> held;
    std::vector<const rtdata::Parcel*> held_parcels;
    double unencodable = -1;
    int begun = 0, sent = 0, cancelled = 0, ended = 0;
    std::size_t most_held = 0;

    /// The peer has it.
    void take(const rtdata::Parcel& parcel, rtdata::Answer answer) {
      for (const auto& row : parcel.rows())
        events.push_back({row.info->run, row.info->topic, row.info->origin, row.sequence, row.time});
      answer.acknowledge();
    }
    /// From here on it takes everything but while it is away.
    void take_unless(const bool& is_away) {
      on_send = [this, &is_away](const rtdata::Parcel& parcel, rtdata::Answer answer) {
        if (is_away) return answer.again(away);
        take(parcel, std::move(answer));
      };
    }
    void hold(const rtdata::Parcel& parcel, rtdata::Answer answer) {
      held.push_back(std::move(answer));
      held_parcels.push_back(&parcel);
      most_held = std::max(most_held, held.size());
    }
    /// Takes the one that is held, counted from 0.
    void take_held(std::size_t which) {
      auto answer = std::move(held[which]);
      const auto* const parcel = held_parcels[which];
      held.erase(held.begin() + static_cast<std::ptrdiff_t>(which));
      held_parcels.erase(held_parcels.begin() + static_cast<std::ptrdiff_t>(which));
      take(*parcel, std::move(answer));
    }
    std::vector<std::uint64_t> sequences() const {
      std::vector<std::uint64_t> all;
      for (const Event& event : events) all.push_back(event.sequence);
      return all;
    }
  };

  explicit ScriptedPeer(std::shared_ptr<Script> script) : script_(std::move(script)) {}
  rtdata::SendingConfig sending() const override { return script_->sending; }
  void begin(rtdata::Loop&) override {
    if (script_->on_begin) script_->on_begin();
    ++script_->begun;
  }
  rtdata::Result<void> encode(const rtdata::Record& record, std::vector<std::byte>& out) override {
    const auto value = record.view().value("value");
    if (value && *value == rtdata::Value{script_->unencodable})
      return rtdata::Error{rtdata::Errc::does_not_fit, "cannot encode", "", "the test says so", ""};
    out.insert(out.end(), record.payload.begin(), record.payload.end());
    return {};
  }
  void send(const rtdata::Parcel& parcel, rtdata::Answer answer) override {
    ++script_->sent;
    if (script_->on_send) return script_->on_send(parcel, std::move(answer));
    script_->take(parcel, std::move(answer));
  }
  void cancel() override {
    ++script_->cancelled;
    script_->held.clear();
    script_->held_parcels.clear();
  }
  void end() override { ++script_->ended; }

 private:
  std::shared_ptr<Script> script_;
};

}  // namespace sinks
