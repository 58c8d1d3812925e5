#include "loop/tier/bridge_sender.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "data/fitting.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration accounts_every = std::chrono::milliseconds{100};
constexpr std::size_t accounts_at_once = 128;
constexpr std::size_t most_entries_beside_sensors = 1000;  // that wait

constexpr std::uint32_t rounded(std::size_t bytes) { return static_cast<std::uint32_t>((bytes + 7) / 8 * 8); }

}  // namespace

// ---- topics, origins, events

Channel::Channel(BridgeSender& bridge, ByteRing& ring, TopicCore& source)
    : payload_bytes_(source.type.size),
      record_bytes(rounded(sizeof(EventRecord) + payload_bytes_)),
      sending{bridge, ring, source},
      bytes_at_hand_(payload_bytes_ <= few_bytes ? record_bytes : PTRDIFF_MAX) {}

void Channel::look_for_room(Passage& passage, Time time, std::uint64_t sequence, const void* payload) {
  constexpr auto usual = ByteRing::Room::usual;
  BridgeSender& bridge = sending.bridge;
  bridge.make_known(record_bytes);
  std::byte* room = bridge.send_drops(passage, usual) ? sending.ring.reserve(record_bytes, usual) : nullptr;
  if (room == nullptr) {
    ++passage.sending.drops.dropped;
    passage.sending.drops.last_sequence = sequence;
    bridge.wake();  // what fills the ring may not have been announced yet
    return;
  }
  std::memcpy(begin_event(room, passage, time, sequence), payload, payload_bytes_);
  sending.ring.commit(record_bytes);
}

BridgeSender::BridgeSender(Bridge& bridge, LoopCore& from, LoopCore& to, ByteRing& ring)
    : bridge_(bridge), from_(from), to_(to), ring_(ring), is_to_main_(to.runtime.hub == nullptr) {
  from_.deadlines.reserve_one();
  from_.runtime.listeners.push_back(this);
  for (const auto& topic : from_.runtime.topics()) {
    [[maybe_unused]] const auto taken = on_topic(*topic);
    for (OriginCore* origin : topic->origins()) {
      if (origin->is_claimed) open(*origin);
    }
  }
}

BridgeSender::~BridgeSender() {
  from_.deadlines.remove(reminder_);
  from_.deadlines.release_one();
  std::erase(from_.runtime.listeners, static_cast<Listener*>(this));
  for (Channel& channel : channels_) channel.sending.source.remove_channel(channel);
}

void BridgeSender::announce(Announcement announcement) {
  to_.runtime.exchange.announce(std::move(announcement));
  has_announced_ = true;
}

Result<void> BridgeSender::on_topic(TopicCore& topic) {
  if (topic.type.move_construct != nullptr || channel_of(topic) != nullptr) return {};
  Channel& channel = channels_.emplace_back(*this, ring_, topic);
  if (channel.record_bytes > ring_.longest_record()) {
    from_.runtime.keep_report(
        &from_, topic.name,
        {Errc::does_not_fit, "events may find no room on their way", "loop " + to_.config.name,
         "its events are too long for the ring to that loop", "make the tier's ring_bytes larger"});
  }
  channel_by_topic_[&topic] = &channel;
  topic.add_channel_out(channel);
  announce({&bridge_, &channel, nullptr, topic.name, topic.type});
  return {};
}

void BridgeSender::open(OriginCore& origin) {
  if (origin.topic.type.move_construct != nullptr)
    return announce({&bridge_, nullptr, nullptr, origin.topic.name, origin.topic.type});
  Channel* channel = channel_of(origin.topic);
  if (channel == nullptr) return;
  auto& of_channel = channel->sending.passages;
  if (of_channel.size() <= origin.index) of_channel.resize(origin.index + 1);
  Passage*& passage = of_channel[origin.index];
  if (passage == nullptr) {
    const auto number = static_cast<std::uint32_t>(passages_.size());
    passage = &passages_.emplace_back(number, origin, *channel, channel->record_bytes);
    announce({&bridge_, channel, passage, origin.name, {}, origin.made_of});
  }
  send_soon();  // it has a schedule before it has events
  origin.topic.find_way(origin);
}

void BridgeSender::on_made_of(OriginCore& origin) {
  Passage* const passage = is_to_main_ ? passage_of(origin) : nullptr;
  if (passage != nullptr) announce({&bridge_, passage->channel, passage, origin.name, {}, origin.made_of});
}

Channel* BridgeSender::channel_of(const TopicCore& topic) noexcept {
  const auto found = channel_by_topic_.find(&topic);
  return found != channel_by_topic_.end() ? found->second : nullptr;
}

Passage* BridgeSender::passage_of(const OriginCore& origin) noexcept {
  const Channel* channel = channel_of(origin.topic);
  return channel != nullptr ? channel->passage_of(origin) : nullptr;
}

void BridgeSender::wake() noexcept {
  if (!has_announced_ && !ring_.has_unpublished()) return;
  has_announced_ = false;
  ring_.publish();
  to_.uv.wake().send();
}

template <class RecordType>
RecordType* BridgeSender::reserve(Sort sort, const Passage& passage, ByteRing::Room room) noexcept {
  constexpr std::uint32_t bytes = rounded(sizeof(RecordType));
  make_known(bytes);
  std::byte* const at = ring_.reserve(bytes, room);
  if (at == nullptr) return nullptr;
  auto* record = ::new (at) RecordType;
  static_cast<BridgeRecord&>(*record) = {bytes, sort, passage.number};
  return record;
}

bool BridgeSender::send_drops(Passage& passage, ByteRing::Room room) noexcept {
  Passage::Sending& sending = passage.sending;
  if (sending.drops.dropped == sending.reported_dropped) return true;
  auto* record = reserve<DropsRecord>(Sort::drops, passage, room);
  if (record == nullptr) return false;
  record->drops = sending.drops;
  sending.reported_dropped = sending.drops.dropped;
  ring_.commit(record->bytes);
  return true;
}

// ---- gaps and segments

void BridgeSender::on_gap(OriginCore& origin, const Gap& gap) { add_entry(origin, gap); }
void BridgeSender::on_segment(OriginCore& origin, const Segment& segment) { add_entry(origin, segment); }

void BridgeSender::add_entry(const OriginCore& origin, const std::variant<Gap, Segment>& entry) {
  Passage* passage = is_to_main_ ? passage_of(origin) : nullptr;
  if (passage == nullptr) return;
  const LedgerEntry one{passage, entry};
  if (send_waiting_entries() && send_entry(one)) return;
  try {
    if (waiting_.size() < most_entries_beside_sensors + 2 * passages_.size()) return waiting_.push_back(one);
  } catch (...) {  // no memory
  }
  ++entries_lost_;
}

bool BridgeSender::send_waiting_entries() noexcept {
  for (; !waiting_.empty(); waiting_.pop_front()) {
    if (!send_entry(waiting_.front())) return false;
  }
  return true;
}

bool BridgeSender::send_entry(const LedgerEntry& entry) noexcept {
  if (const Gap* gap = std::get_if<Gap>(&entry.entry)) {
    auto* record = reserve<GapRecord>(Sort::gap, *entry.passage, ByteRing::Room::all);
    if (record == nullptr) return false;
    record->gap = *gap;
    ring_.commit(record->bytes);
  } else {
    auto* record = reserve<SegmentRecord>(Sort::segment, *entry.passage, ByteRing::Room::all);
    if (record == nullptr) return false;
    record->segment = std::get<Segment>(entry.entry);
    ring_.commit(record->bytes);
  }
  return true;
}

void BridgeSender::report_lost_entries(LoopCore& on) {
  const std::uint64_t lost = std::exchange(entries_lost_, 0);
  if (lost == 0) [[likely]]
    return;
  on.runtime.keep_report(
      &on, "loop " + from_.config.name,
      {Errc::does_not_fit, "lost " + std::to_string(lost) + " gaps or segments", "loop " + to_.config.name,
       "the ring to this loop is full; its recordings will not have these gaps and segments",
       "make the tier's ring_bytes larger"});
}

// ---- errors and changes of health

void BridgeSender::on_error(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) {
  if (!is_to_main_) return;
  from_.runtime.reports.post_to_main([&to = to_, first, last, object = std::string(object), error, count] {
    for (Listener* listener : to.runtime.recorders) listener->on_error(first, last, object, error, count);
  });
}

void BridgeSender::on_health(Time first, Time last, const HealthChange& change, std::uint64_t count) {
  if (!is_to_main_) return;
  from_.runtime.reports.post_to_main([&to = to_, first, last, change, count] {
    for (Listener* listener : to.runtime.recorders) listener->on_health(first, last, change, count);
  });
}

// ---- accounts

AccountSummary BridgeSender::summary_of(const OriginCore& origin) const noexcept {
  const SensorCounts& counts = origin.counts;
  AccountSummary summary{counts.scheduled + counts.received + counts.taken + counts.failed + counts.lost +
                         origin.sequence + origin.ended_outages().number};
  if (const SensorEntry* sensor = origin.sensor; sensor != nullptr) {
    summary.period = sensor->schedule_period();
    summary.has_sensor = true;
    summary.is_active = sensor->is_active();
    summary.health = sensor->health();
  }
  summary.has_gap = origin.gap_under_way() != nullptr;
  summary.is_absent = origin.absent_since() != Time::min();
  return summary;
}

void BridgeSender::take_snapshot(const OriginCore& origin, OriginSnapshot& to) const noexcept {
  const AccountSummary summary = summary_of(origin);
  to.counts = origin.counts;
  to.sequence = origin.sequence;
  to.under_way = origin.has_segment() ? origin.segment(from_.deadlines.handled_until()) : Segment{};
  to.has_gap = summary.has_gap;
  if (to.has_gap) to.gap = *origin.gap_under_way();
  to.outages = origin.ended_outages();
  to.absent_since = origin.absent_since();
  to.has_sensor = summary.has_sensor;
  to.period = summary.period;
  to.is_active = summary.is_active;
  to.health = summary.health;
  const std::string_view reason = origin.sensor != nullptr ? origin.sensor->reason() : std::string_view();
  to.reason[put_fitting(to.reason, sizeof to.reason - 1, reason)] = '\0';
}

bool BridgeSender::send_account(Passage& passage, ByteRing::Room room) noexcept {
  if (!send_drops(passage, room)) return false;
  if (!is_to_main_) return true;
  const AccountSummary summary = summary_of(*passage.sending.source);
  if (summary == passage.sending.last_account) return true;
  auto* record = reserve<AccountRecord>(Sort::account, passage, room);
  if (record == nullptr) return false;
  passage.sending.last_account = summary;
  take_snapshot(*passage.sending.source, record->account);
  ring_.commit(record->bytes);
  return true;
}

std::size_t BridgeSender::send_accounts() {
  std::size_t left = passages_.size();
  if (send_waiting_entries()) {
    for (Passage& passage : passages_) {
      if (!send_account(passage, ByteRing::Room::all)) break;
      --left;
    }
  }
  left += waiting_.size();
  wake();
  return left;
}

BridgeSender::AccountsSent BridgeSender::send_all_accounts() {
  for (const Passage& passage : passages_) passage.sending.source->divide_gaps();
  const std::size_t left = send_accounts();
  return {left, ring_.published()};
}

void BridgeSender::send_some_accounts() {
  if (!send_waiting_entries()) return;
  for (std::size_t i = 0; i < accounts_at_once && accounts_left_ > 0; ++i, --accounts_left_) {
    if (next_account_ >= passages_.size()) next_account_ = 0;
    if (!send_account(passages_[next_account_], ByteRing::Room::usual)) return;
    ++next_account_;
  }
}

void BridgeSender::Reminder::fire(MonotonicTime) {
  sender.from_.deadlines.remove(*this);
  sender.is_reminded_ = true;
}

void BridgeSender::turn_done() {
  report_lost_entries(from_);
  if (!passages_.empty()) {
    const MonotonicTime now = from_.now();
    if (!std::exchange(is_reminded_, false)) accounts_left_ = passages_.size();
    if (now >= next_accounts_) {
      next_accounts_ = now + accounts_every;
      send_some_accounts();
    }
    if (accounts_left_ > 0 && !reminder_.is_listed()) {
      reminder_.due = next_accounts_;
      from_.deadlines.insert(reminder_);
    }
  }
  wake();
}

}  // namespace rtdata::detail
