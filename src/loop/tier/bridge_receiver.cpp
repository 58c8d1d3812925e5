#include "loop/tier/bridge_receiver.hpp"

#include <algorithm>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/events/made_of.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/gaps.hpp"

namespace rtdata::detail {

BridgeReceiver::~BridgeReceiver() {
  for (const Passage* passage : open_)
    if (passage != nullptr && passage->receiving.mirror != nullptr) passage->receiving.mirror->comes_from = nullptr;
  for (Channel* channel : channels_) channel->receiving.mirror->remove_channel(*channel);
}

// ---- announcements

void BridgeReceiver::hear(const Announcement& announcement) {
  if (announcement.passage == nullptr) return receive_topic(announcement);
  receive_origin(announcement);
}

void BridgeReceiver::receive_topic(const Announcement& announcement) {
  RuntimeCore& here = to_.runtime;
  try {
    TopicCore& topic = here.find_or_make_topic(announcement.name, announcement.type);
    if (Channel* const channel = announcement.channel; channel != nullptr) {
      channels_.push_back(channel);
      channel->receiving.mirror = &topic;
      topic.add_channel_in(*channel);
    } else {
      topic.cut_off_from = from_.config.name;
      here.exchange.report_cut_off(topic);
    }
  } catch (const SetupError& e) {
    here.keep_report(&to_, "loop " + from_.config.name, e.error());
  }
}

void BridgeReceiver::receive_origin(const Announcement& announcement) {
  Passage& passage = *announcement.passage;
  if (TopicCore* const topic = passage.channel->receiving.mirror; topic != nullptr) {
    OriginCore& origin = to_.runtime.find_or_make_origin(announcement.name, *topic);
    topic->expect(origin);
    origin.expect_gaps();
    origin.is_mirror = true;
    origin.comes_from = &from_;
    passage.receiving.mirror = &origin;
    if (!announcement.made_of.empty()) set_made_of(origin, announcement.made_of);
  }
  if (open_.size() <= passage.number) open_.resize(passage.number + 1);
  open_[passage.number] = &passage;
}

// ---- records

void BridgeReceiver::receive() {
  do {
    to_.runtime.exchange.take_announcements();  // it was announced before it was sent
    ring_.look();
  } while (!take_seen());
}

void BridgeReceiver::receive_up_to(std::size_t position) {
  to_.runtime.exchange.take_announcements();
  ring_.look_up_to(position);
  while (!take_seen()) to_.runtime.exchange.take_announcements();
}

bool BridgeReceiver::take_seen() {
  while (const std::byte* front = ring_.front()) {
    const auto& record = *reinterpret_cast<const BridgeRecord*>(front);
    Passage* const passage = record.passage() < open_.size() ? open_[record.passage()] : nullptr;
    if (passage == nullptr) return false;
    if (record.sort() == BridgeRecord::Sort::event) {
      take_events(static_cast<const EventRecord&>(record), *passage);
    } else {
      if (passage->receiving.mirror != nullptr) take_record(record, *passage);
      ring_.pop();
    }
    ring_.release();
  }
  return true;
}

void BridgeReceiver::take_events(const EventRecord& first, Passage& passage) {
  const std::size_t stride = first.bytes;
  // Later ones of the same sensor.
  const std::size_t most = std::min<std::size_t>(ring_.straight_bytes() / stride, 64);
  const auto* at = reinterpret_cast<const std::byte*>(&first);
  std::size_t count = 1;
  for (at += stride; count < most && *reinterpret_cast<const BridgeRecord*>(at) == first; at += stride) {
    ByteRing::fetch_for_reading(at);
    ++count;
  }
  if (passage.receiving.mirror == nullptr) [[unlikely]] {
    to_.runtime.exchange.lost += count;  // its topic cannot be what it is elsewhere, which was reported
  } else {
    passage.receiving.mirror->topic.receive(*passage.receiving.mirror, &first.event, count, stride);
  }
  ring_.pop(count * stride);
}

void BridgeReceiver::take_record(const BridgeRecord& record, Passage& passage) {
  switch (record.sort()) {
    case BridgeRecord::Sort::event:
      break;  // see above
    case BridgeRecord::Sort::gap:
      return take_entry(static_cast<const GapRecord&>(record).gap, *passage.receiving.mirror);
    case BridgeRecord::Sort::segment:
      return take_entry(static_cast<const SegmentRecord&>(record).segment, *passage.receiving.mirror);
    case BridgeRecord::Sort::account:
      return take_account(static_cast<const AccountRecord&>(record).account, passage);
    case BridgeRecord::Sort::drops:
      return take_drops(static_cast<const DropsRecord&>(record).drops, passage);
  }
}

void BridgeReceiver::take_entry(const std::variant<Gap, Segment>& entry, OriginCore& mirror) {
  const auto& recorders = to_.runtime.recorders;
  if (const Gap* gap = std::get_if<Gap>(&entry)) {
    mirror.forget_gap();  // it was under way in an account
    for (Listener* listener : recorders) listener->on_gap(mirror, *gap);
    publish_gap(mirror, *gap);
  } else {
    for (Listener* listener : recorders) listener->on_segment(mirror, std::get<Segment>(entry));
    mirror.forget_segment();  // its account, which comes later, knows no more of it than this
  }
}

void BridgeReceiver::take_drops(const Drops& drops, Passage& passage) {
  const std::uint64_t more = drops.dropped - std::exchange(passage.receiving.known_dropped, drops.dropped);
  OriginCore& mirror = *passage.receiving.mirror;
  if (more > 0) mirror.topic.miss(mirror, more, drops.last_sequence);
}

void BridgeReceiver::take_account(const OriginSnapshot& account, Passage& passage) {
  Passage::Receiving& here = passage.receiving;
  here.mirror->mirror(account.counts, account.sequence, account.under_way, account.has_gap ? &account.gap : nullptr);
  here.mirror->mirror(account.outages, account.absent_since);
  here.period = account.period;
  here.is_active = account.is_active;
  here.has_sensor = account.has_sensor;
  here.health = account.health;
  if (here.reason != account.reason) here.reason = account.reason;
}

void BridgeReceiver::add_statuses(std::vector<SensorStatus>& all) const {
  for (const Passage* passage : open_) {
    if (passage == nullptr || !passage->receiving.has_sensor) continue;
    const Passage::Receiving& here = passage->receiving;
    all.push_back({here.mirror->name, here.mirror->topic.name, here.period, here.is_active, here.health, here.reason,
                   here.mirror->counts, from_.config.name, here.mirror->first_due(),
                   here.mirror->outages(to_.runtime.event_now())});
    if (!from_.is_standing()) continue;
    all.back().health = Health::faulted;
    all.back().reason = "its loop does not turn: this is its last known state";
  }
}

}  // namespace rtdata::detail
