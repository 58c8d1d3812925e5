#include "loop/tier/bridge.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/support/fitting.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration accounts_every = std::chrono::milliseconds{100};
constexpr std::size_t accounts_at_once = 128;
constexpr std::size_t most_notes_beside_sensors = 1000;  // that wait

constexpr std::uint32_t rounded(std::size_t bytes) { return static_cast<std::uint32_t>((bytes + 7) / 8 * 8); }

}  // namespace

Channel::Channel(Bridge& bridge, TopicCore& source)
    : ring_(bridge.ring_),
      payload_bytes_(source.type.size),
      record_bytes_(rounded(sizeof(EventRecord) + payload_bytes_)),
      bytes_at_hand_(payload_bytes_ <= few_bytes ? record_bytes_ : PTRDIFF_MAX),
      bridge_(bridge),
      source_(source) {}

void Channel::look_for_room(Passage& passage, Time time, std::uint64_t sequence, const void* payload) {
  constexpr auto usual = ByteRing::Room::usual;
  bridge_.make_known(record_bytes_);
  std::byte* room = bridge_.send_drops(passage, usual) ? ring_.reserve(record_bytes_, usual) : nullptr;
  if (room == nullptr) {
    ++passage.sending.dropped;
    passage.sending.last_dropped = sequence;
    bridge_.wake();  // what fills the ring may not have been announced yet
    return;
  }
  std::memcpy(begin_event(room, passage, time, sequence), payload, payload_bytes_);
  ring_.commit(record_bytes_);
}

Bridge::Bridge(LoopCore& from, LoopCore& to, std::size_t ring_bytes)
    : from_(from), to_(to), ring_(ring_bytes), is_to_main_(to.runtime.hub == nullptr) {
  from_.deadlines.reserve_one();
  from_.runtime.outbound.push_back(this);
  to_.runtime.inbound.push_back(this);
  from_.runtime.listeners.push_back(this);
  for (const auto& topic : from_.runtime.topics()) {
    [[maybe_unused]] const auto taken = on_topic(*topic);
    for (OriginCore* origin : topic->origins()) on_origin(*origin);
  }
}

Bridge::~Bridge() {
  from_.deadlines.remove(reminder_);
  from_.deadlines.release_one();
  to_.runtime.exchange.forget(*this);
  for (Passage* passage : heard_) {
    if (passage != nullptr && passage->receiving.mirror != nullptr && !passage->receiving.is_past)
      passage->receiving.mirror->passage = nullptr;
  }
  std::erase(from_.runtime.outbound, this);
  std::erase(to_.runtime.inbound, this);
  std::erase(from_.runtime.listeners, static_cast<Listener*>(this));
  for (Channel& channel : channels_) {
    channel.source_.remove_channel(channel);
    if (channel.mirror_ != nullptr) channel.mirror_->remove_channel(channel);
  }
}

// ---- the sending side

void Bridge::wake() noexcept {
  if (!has_announced_ && !ring_.has_unpublished()) return;
  has_announced_ = false;
  ring_.publish();
  to_.uv.wake().send();
}

void Bridge::announce(Channel* channel, Passage* passage, const std::string& name, PayloadType type) {
  to_.runtime.exchange.announce({this, channel, passage, name, std::move(type)});
  has_announced_ = true;
}

Result<void> Bridge::on_topic(TopicCore& topic) {
  if (topic.type.move_construct != nullptr || channel_of(topic) != nullptr) return {};
  Channel& channel = channels_.emplace_back(*this, topic);
  if (channel.record_bytes_ > ring_.longest_record()) {
    from_.runtime.keep_report(&from_, topic.name,
                              {Errc::does_not_fit, "may find no room on its way", "loop " + to_.config.name,
                               "its events are long for the ring to it", "make the tier's ring_bytes larger"});
  }
  channel_by_topic_[&topic] = &channels_.back();
  topic.add_channel_out(channels_.back());
  announce(&channels_.back(), nullptr, topic.name, topic.type);
  return {};
}

void Bridge::on_origin(OriginCore& origin) {
  if (origin.is_mirror) return;
  if (origin.topic.type.move_construct != nullptr)
    return announce(nullptr, nullptr, origin.topic.name, origin.topic.type);
  Channel* channel = channel_of(origin.topic);
  if (channel == nullptr) return;
  const auto number = static_cast<std::uint32_t>(passages_.size());
  Passage& passage = passages_.emplace_back(number, origin, *channel,
                                            static_cast<std::uint32_t>(channel->record_bytes_));
  if (channel->passages_.size() <= origin.index) channel->passages_.resize(origin.index + 1);
  channel->passages_[origin.index] = &passage;
  next_accounts_ = {};  // it has a schedule before it has events: with the end of this turn
  origin.topic.find_way(origin);
  announce(channel, &passage, origin.name, {});
}

Channel* Bridge::channel_of(const TopicCore& topic) noexcept {
  const auto found = channel_by_topic_.find(&topic);
  return found != channel_by_topic_.end() ? found->second : nullptr;
}

Passage* Bridge::passage_of(const OriginCore& origin) noexcept {
  const Channel* channel = channel_of(origin.topic);
  return channel != nullptr ? channel->passage_of(origin) : nullptr;
}

template <class RecordType>
RecordType* Bridge::reserve(Sort sort, const Passage& passage, ByteRing::Room room) noexcept {
  constexpr std::uint32_t bytes = rounded(sizeof(RecordType));
  make_known(bytes);
  std::byte* const at = ring_.reserve(bytes, room);
  if (at == nullptr) return nullptr;
  auto* record = ::new (at) RecordType;
  static_cast<Record&>(*record) = {bytes, sort, passage.number};
  return record;
}

bool Bridge::send_drops(Passage& passage, ByteRing::Room room) noexcept {
  if (passage.sending.dropped == passage.sending.reported_dropped) return true;
  auto* record = reserve<DropsRecord>(Sort::drops, passage, room);
  if (record == nullptr) return false;
  record->dropped = passage.sending.reported_dropped = passage.sending.dropped;
  record->last_sequence = passage.sending.last_dropped;
  ring_.commit(record->bytes);
  return true;
}

void Bridge::on_gap(OriginCore& origin, const Gap& gap) {
  Passage* passage = is_to_main_ ? passage_of(origin) : nullptr;
  if (passage == nullptr) return;
  note({passage, gap});
}

void Bridge::on_segment(OriginCore& origin, const Segment& segment) {
  Passage* passage = is_to_main_ ? passage_of(origin) : nullptr;
  if (passage == nullptr) return;
  note({passage, segment});
}

void Bridge::note(Note note) {
  if (send_notes() && send(note)) return;
  try {
    if (notes_.size() < most_notes_beside_sensors + 2 * passages_.size()) return notes_.push_back(note);
  } catch (...) {  // no memory
  }
  ++notes_lost_;
}

bool Bridge::send_notes() noexcept {
  for (; !notes_.empty(); notes_.pop_front()) {
    if (!send(notes_.front())) return false;
  }
  return true;
}

bool Bridge::send(const Note& note) noexcept {
  if (const Gap* gap = std::get_if<Gap>(&note.what)) {
    auto* record = reserve<GapRecord>(Sort::gap, *note.passage, ByteRing::Room::all);
    if (record == nullptr) return false;
    record->gap = *gap;
    ring_.commit(record->bytes);
  } else {
    auto* record = reserve<SegmentRecord>(Sort::segment, *note.passage, ByteRing::Room::all);
    if (record == nullptr) return false;
    record->segment = std::get<Segment>(note.what);
    ring_.commit(record->bytes);
  }
  return true;
}

void Bridge::on_error(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) {
  if (!is_to_main_) return;
  from_.runtime.reports.post_to_main([&to = to_, first, last, object = std::string(object), error, count] {
    for (Listener* listener : to.runtime.recorders) listener->on_error(first, last, object, error, count);
  });
}

void Bridge::on_health(Time first, Time last, const HealthChange& change, std::uint64_t count) {
  if (!is_to_main_) return;
  from_.runtime.reports.post_to_main([&to = to_, first, last, change, count] {
    for (Listener* listener : to.runtime.recorders) listener->on_health(first, last, change, count);
  });
}

bool Bridge::send_account(Passage& passage, ByteRing::Room room) noexcept {
  if (!send_drops(passage, room)) return false;
  if (passage.sending.is_given_up || !is_to_main_) return true;
  const OriginCore& origin = *passage.sending.source;
  const SensorEntry* sensor = origin.sensor;
  const SensorCounts& counts = origin.counts;
  const Outages outages = origin.ended_outages();
  AccountSummary summary{counts.scheduled + counts.received + counts.taken + counts.failed + counts.lost +
                         origin.sequence + outages.number};
  if (sensor != nullptr) {
    summary.period = sensor->schedule_period();
    summary.has_sensor = true;
    summary.is_active = sensor->is_active();
    summary.health = sensor->health();
  }
  summary.has_gap = origin.gap_under_way() != nullptr;
  summary.is_absent = origin.absent_since() != Time::min();
  if (summary == passage.sending.last_account) return true;
  auto* record = reserve<AccountRecord>(Sort::account, passage, room);
  if (record == nullptr) return false;
  passage.sending.last_account = summary;
  record->counts = counts;
  record->sequence = origin.sequence;
  record->under_way = origin.has_segment() ? origin.segment(from_.deadlines.handled_until()) : Segment{};
  record->has_gap = origin.gap_under_way() != nullptr;
  if (record->has_gap) record->gap = *origin.gap_under_way();
  record->outages = outages;
  record->absent_since = origin.absent_since();
  record->has_sensor = summary.has_sensor;
  record->period = summary.period;
  record->is_active = summary.is_active;
  record->health = summary.health;
  const std::string_view reason = sensor != nullptr ? sensor->reason() : std::string_view();
  record->reason[put_fitting(record->reason, sizeof record->reason - 1, reason)] = '\0';
  ring_.commit(record->bytes);
  return true;
}

std::size_t Bridge::send_accounts() {
  std::size_t left = passages_.size();
  if (send_notes()) {
    for (Passage& passage : passages_) {
      if (!send_account(passage, ByteRing::Room::all)) break;
      --left;
    }
  }
  left += notes_.size();
  wake();
  return left;
}

Bridge::AccountsSent Bridge::send_all_accounts() {
  for (const Passage& passage : passages_) {
    if (!passage.sending.is_given_up) passage.sending.source->divide_gaps();
  }
  const std::size_t left = send_accounts();
  return {left, ring_.published()};
}

void Bridge::send_some_accounts() {
  if (!send_notes()) return;
  for (std::size_t i = 0; i < accounts_at_once && accounts_left_ > 0; ++i, --accounts_left_) {
    if (next_account_ >= passages_.size()) next_account_ = 0;
    if (!send_account(passages_[next_account_], ByteRing::Room::usual)) return;
    ++next_account_;
  }
}

void Bridge::give_up(const OriginCore& origin) noexcept {
  Passage* passage = passage_of(origin);
  if (passage == nullptr) return;
  passage->sending.is_given_up = true;
}

void Bridge::hand_over() {
  wake();
  receive();
}

void Bridge::finish() {
  hand_over();
  std::size_t before = SIZE_MAX;
  for (std::size_t left = send_accounts(); left > 0 && left < before; left = send_accounts()) {
    receive();
    before = left;
  }
  receive();
  report_lost_notes(to_);
}

void Bridge::report_lost_notes(LoopCore& on) {
  const std::uint64_t lost = std::exchange(notes_lost_, 0);
  if (lost == 0) [[likely]]
    return;
  on.runtime.keep_report(
      &on, "loop " + from_.config.name,
      {Errc::does_not_fit, "lost " + std::to_string(lost) + " gaps or segments", "loop " + to_.config.name,
       "the ring to it is full, so its recordings lack them", "make the tier's ring_bytes larger"});
}

void Bridge::Reminder::fire(MonotonicTime) {
  bridge.from_.deadlines.remove(*this);
  bridge.is_reminded_ = true;
}

void Bridge::turn_done() {
  report_lost_notes(from_);
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

// ---- the receiving side

void Bridge::hear(Announcement& announcement) {
  RuntimeCore& here = to_.runtime;
  Channel* const channel = announcement.channel;
  Passage* const passage = announcement.passage;
  if (passage == nullptr) {
    try {
      TopicCore& topic = here.find_or_make_topic(announcement.name, std::move(announcement.type));
      if (channel != nullptr) {
        channel->mirror_ = &topic;
        topic.add_channel_in(*channel);
      } else {
        topic.cut_off_from = from_.config.name;
        here.exchange.report_cut_off(topic);
      }
    } catch (const SetupError& e) {
      here.keep_report(&to_, "loop " + from_.config.name, e.error());
    }
    return;
  }
  if (channel->mirror_ != nullptr) {
    if (OriginCore* known = here.find_origin(announcement.name)) {
      ++here.exchange.takeovers;
      // Another loop had the name. What it published is in its ring already, before anything that is not heard of yet.
      for (Bridge* bridge : here.inbound) bridge->take_heard();
      for (Bridge* bridge : here.outbound) bridge->give_up(*known);
    }
    OriginCore& origin = here.find_or_make_origin(announcement.name, *channel->mirror_);
    channel->mirror_->expect(origin);
    origin.expect_gaps();
    origin.become_mirror(*passage);
  }
  if (heard_.size() <= passage->number) heard_.resize(passage->number + 1);
  heard_[passage->number] = passage;
}

void Bridge::receive() {
  do {
    to_.runtime.exchange.take_announcements();  // it was announced before it was sent
  } while (!take_heard());
}

void Bridge::receive_up_to(std::size_t position) {
  to_.runtime.exchange.take_announcements();
  ring_.look_up_to(position);
  while (!take_seen()) to_.runtime.exchange.take_announcements();
}

bool Bridge::take_heard() {
  ring_.look();
  return take_seen();
}

bool Bridge::take_seen() {
  while (const std::byte* front = ring_.front()) {
    const auto& record = *reinterpret_cast<const Record*>(front);
    Passage* const passage = record.passage() < heard_.size() ? heard_[record.passage()] : nullptr;
    if (passage == nullptr) return false;
    if (record.sort() == Sort::event) {
      take_events(static_cast<const EventRecord&>(record), *passage);
    } else {
      if (passage->receiving.mirror != nullptr) take(record, *passage);
      ring_.pop();
    }
    ring_.release();
  }
  return true;
}

void Bridge::take_events(const EventRecord& first, Passage& passage) {
  const std::size_t stride = first.bytes;
  // Those of the same sensor behind it.
  const std::size_t most = std::min<std::size_t>(ring_.straight_bytes() / stride, 64);
  const auto* at = reinterpret_cast<const std::byte*>(&first);
  std::size_t count = 1;
  for (at += stride; count < most && *reinterpret_cast<const Record*>(at) == first; at += stride) {
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

void Bridge::take(const Record& record, Passage& passage) {
  Passage::Receiving& here = passage.receiving;
  OriginCore& mirror = *here.mirror;
  switch (record.sort()) {
    case Sort::event:
      break;  // see above
    case Sort::gap:
      if (!here.is_past) mirror.forget_gap();  // it was under way in an account
      for (Listener* listener : to_.runtime.recorders)
        listener->on_gap(mirror, static_cast<const GapRecord&>(record).gap);
      break;
    case Sort::segment:
      for (Listener* listener : to_.runtime.recorders) {
        listener->on_segment(mirror, static_cast<const SegmentRecord&>(record).segment);
      }
      if (!here.is_past) mirror.forget_segment();  // its account, told later, knows no more of it than this
      break;
    case Sort::account: {
      const auto& account = static_cast<const AccountRecord&>(record);
      if (here.is_past) break;  // the new holder of the name tells more
      mirror.mirror(account.counts, account.sequence, account.under_way, account.has_gap ? &account.gap : nullptr);
      mirror.mirror(account.outages, account.absent_since);
      here.period = account.period;
      here.is_active = account.is_active;
      here.has_sensor = account.has_sensor;
      here.health = account.health;
      if (here.reason != account.reason) here.reason = account.reason;
      break;
    }
    case Sort::drops: {
      const auto& drops = static_cast<const DropsRecord&>(record);
      const std::uint64_t more = drops.dropped - std::exchange(here.known_dropped, drops.dropped);
      mirror.topic.miss(mirror, more, drops.last_sequence);
      break;
    }
  }
}

void Bridge::add_statuses(std::vector<SensorStatus>& all) const {
  for (const Passage* passage : heard_) {
    if (passage == nullptr || !passage->receiving.has_sensor || passage->receiving.is_past) continue;
    const Passage::Receiving& here = passage->receiving;
    all.push_back({here.mirror->name, here.mirror->topic.name, here.period, here.is_active, here.health, here.reason,
                   here.mirror->counts, from_.config.name, here.mirror->first_due(),
                   here.mirror->outages(to_.runtime.event_now())});
  }
}

}  // namespace rtdata::detail
