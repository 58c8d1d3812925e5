// `rtdata view DB`: the page of a recording, also while another process records it.
#include <signal.h>

#include <algorithm>
#include <iostream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <utility>

#include "app/control/event_stream.hpp"
#include "app/control/past_reader.hpp"
#include "app/control/status.hpp"
#include "app/core/recording_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/recorded_range.hpp"
#include "app/page/disk_work.hpp"
#include "app/page/page_history.hpp"
#include "app/page/page_server.hpp"
#include "app/page/page_setup.hpp"
#include "recording/account_text.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/loop/clock.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/runs.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr Duration step = std::chrono::milliseconds{250};
constexpr Duration before_now = std::chrono::seconds{3};  // events that are stored later than they came

double in_ms(Time time) { return static_cast<double>(to_nanoseconds(time)) / 1e6; }

Status status_of_run(const Recording& recording, const RunReport& report) {
  const std::string& path = recording.path();
  const std::int64_t number = report.info.run;
  Status status;
  status.instance = {report.info.name, report.info.pid, to_iso8601(report.line.utc(report.info.started)),
                     report.info.ended.value_or(report.info.started) - report.info.started, path};
  std::map<std::string, Duration> periods;
  for (const RecordedSegment& segment : recording.schedule(number).or_throw())
    periods[segment.origin] = segment.segment.period;
  std::map<std::string, const OriginOutages*> outages;
  for (const OriginOutages& one : report.outages) outages[one.origin] = &one;
  Status::Sink& sink = status.sinks.emplace_back();
  sink.name = sink.path = path;
  const auto add = [](Status::Account& to, const Status::Account& of) {
    to.published += of.published, to.late += of.late, to.missed += of.missed, to.failed += of.failed;
    to.unreadable += of.unreadable, to.failed_unreadable += of.failed_unreadable, to.lost += of.lost,
        to.dropped += of.dropped;
    to.lost_is_known = to.lost_is_known || of.lost_is_known;
    to.outages.add(of.outages);
  };
  for (const LedgerEntry& entry : recording.ledger(number).or_throw()) {
    Status::Sensor& sensor = status.sensors.emplace_back();
    const SensorCounts& counts = entry.sensor;
    sensor.name = entry.origin, sensor.topic = entry.topic, sensor.is_running = true;
    sensor.published = counts.published, sensor.late = counts.late, sensor.missed = counts.missed;
    sensor.failed = counts.failed, sensor.unreadable = counts.unreadable, sensor.lost = counts.lost;
    sensor.failed_unreadable = detail::failed_unreadable(counts);
    sensor.lost_is_known = counts.lost_is_known, sensor.dropped = entry.dropped();
    if (const auto one = outages.find(entry.origin); one != outages.end()) sensor.outages = one->second->outages;
    if (const auto period = periods.find(entry.origin); period != periods.end() && period->second > Duration{0})
      sensor.wanted_hz = 1e9 / static_cast<double>(period->second.count());
    add(status.total, sensor);
    sink.offered += entry.offered, sink.stored += entry.stored;
    sink.dropped[0] += entry.dropped();
  }
  for (const RecordedHealth& change : recording.health(number).or_throw()) {
    for (Status::Sensor& sensor : status.sensors) {
      if (change.kind != "sensor" || change.name != sensor.name) continue;
      sensor.health = change.state == "ok"        ? Health::ok
                      : change.state == "faulted" ? Health::faulted
                                                  : Health::degraded;
      sensor.reason = change.reason;
    }
  }
  return status;
}

/// Thread: the loop's; it reads the disk on a lane.
class RecordedSource final : public PageSource {
 public:
  RecordedSource(Loop& loop, const Registry& registry, std::string path, const std::optional<std::string>& which)
      : path_(std::move(path)), disk_(loop, "recording") {
    const Recording recording = Recording::open(path_).or_throw();
    run_ = find_run(recording.runs().or_throw(), which.value_or("-1"), path_).or_throw();
    const RunReport report = account_of(recording, run_.run).or_throw();
    is_recording_ = run_.boot_id == SystemClock().boot_id() && report.verdict == Verdict::recording;
    Json about{{"name", run_.name}, {"notes", run_.notes}, {"parts", Json::array()}};
    if (!run_.configuration.empty()) {
      const SystemPlan plan = plan_system(registry, parse_config(run_.configuration));
      about = Json::parse(page_setup(plan));
      about["name"] = run_.name;
    }
    tell_state(about, recording, report);
    if (is_recording_ && about["run"].contains("clock")) clock_ = about["run"]["clock"];
    for (const RecordedTopic& topic : recording.topics().or_throw())
      for (const Leaf& leaf : topic.description->leaves()) about["fields"][topic.topic][leaf.path] = leaf.unit;
    about_ = about.dump(-1, ' ', false, Json::error_handler_t::replace);
  }
  RecordedSource(const RecordedSource&) = delete;

  void begin() override {
    if (!is_recording_) return;
    past_ = make_past_reader(path_, {"#"}, now() - before_now);
    StreamRequest of_steps;
    of_steps.step = step;
    steps_ = std::make_unique<EventStream>(of_steps, run_.uuid, "");
    changes_ = std::make_unique<EventStream>(StreamRequest{.topics = changing_}, run_.uuid, "");
  }
  void end() override { past_.reset(); }
  void lines(const std::function<void(std::string_view)>& take) override {
    take(is_recording_ ? Json{{"machine", {{"now", in_ms(now())}, {"clock", clock_}, {"disks", Json::array()}}}}.dump()
                       : std::string(R"({"now":0})"));
    if (std::exchange(has_news_, false)) take("{\"about\":" + about_ + "}");
    if (past_ == nullptr) return;
    if (!is_reading_) read();
    for (EventStream* stream : {steps_.get(), changes_.get()}) {
      stream->turn(now() - std::chrono::seconds{2});  // steps are complete once the recording has them
      std::string_view text = stream->text();
      const std::size_t size = text.size();
      for (std::size_t end = text.find('\n'); end != std::string_view::npos; end = text.find('\n')) {
        take(text.substr(0, end));
        text.remove_prefix(end + 1);
      }
      stream->sent(size);
    }
    if (!failed_.empty()) take(Json{{"error", std::exchange(failed_, {})}}.dump());
  }
  std::string about() override { return about_; }
  void status(Told told) override {
    // Its recorder may end, or be killed, while it is shown.
    const auto over = std::make_shared<std::string>(is_recording_ ? about_ : std::string());
    disk_.submit(
        [path = path_, run = run_.run, over] {
          const Recording recording = Recording::open(path).or_throw();
          const RunReport report = account_of(recording, run).or_throw();
          if (!over->empty() && report.verdict == Verdict::recording) over->clear();
          if (!over->empty()) {
            Json about = Json::parse(*over);
            tell_state(about, recording, report);
            *over = about.dump(-1, ' ', false, Json::error_handler_t::replace);
          }
          Status status = status_of_run(recording, report);
          return json_of(status);
        },
        [this, over, told = std::move(told)](std::string text) {
          if (is_recording_ && !over->empty()) {
            is_recording_ = false;
            has_news_ = true;
            about_ = *over;
          }
          told(std::move(text));
        });
  }
  void history(std::string request, Told told) override {
    disk_.submit(
        [path = path_, run = run_.run, request = std::move(request)] {
          return page_history({{"", path}}, run, request);
        },
        std::move(told));
  }
  void command(std::vector<std::string>, std::string, Told told) override {
    told(R"({"refused":"a recording takes no commands"})");
  }

 private:
  /// True if it is still recorded; its end; and what is not known about it.
  static void tell_state(Json& about, const Recording& recording, const RunReport& report) {
    about["recording"] = report.verdict == Verdict::recording && report.info.boot_id == SystemClock().boot_id();
    about["run"] = page_run(recording, report.info);
    if (about["recording"] == false) about["run"]["ended"] = in_ms(last_instant(recording, report.info));
    about["not_known"] = about["recording"] == true ? std::vector<std::string>() : report.not_known;
  }
  Time now() const { return Time{std::chrono::steady_clock::now().time_since_epoch() + run_.clock_offset}; }
  void read() {
    is_reading_ = true;
    const auto slice = std::make_shared<PastReader::Slice>();
    disk_.submit(
        [past = past_, slice] {
          *slice = past->read();
          return std::string();
        },
        [this, past = past_, slice](const std::string& failed) {
          is_reading_ = false;
          if (failed.empty() && past == past_) take(*slice);
        });
  }
  void take(const PastReader::Slice& slice) {
    for (std::size_t at = 0; at < slice.events.size();) {
      const auto& event = *reinterpret_cast<const PackedEvent*>(slice.events.data() + at);
      at += event.bytes;
      if (event.run != static_cast<std::uint32_t>(run_.run)) continue;
      line_.set(event);
      const StreamOrigin& origin = origins_.of(event);
      steps_->take(event, origin, line_);
      if (is_change(*event.description)) changes_->take(event, origin, line_);
    }
    failed_ = slice.failed;
    if (slice.has_more) read();
  }

  const std::string path_;
  RunInfo run_;
  bool is_recording_ = false;
  bool has_news_ = false;  // in `about_`
  std::string about_;
  Json clock_ = nullptr;
  const std::vector<std::string> changing_ = {"#"};
  std::shared_ptr<PastReader> past_;
  std::unique_ptr<EventStream> steps_, changes_;
  StreamOrigins origins_;
  EventLine line_;
  bool is_reading_ = false;
  std::string failed_;
  DiskWork disk_;
};

}  // namespace

int view(const Registry& registry, const ViewOptions& options, std::ostream& err) try {
  Loop loop({.name = "view", .hold_limit = std::chrono::hours{1}});
  RecordedSource source(loop, registry, options.database, options.run);
  const PageAddress address = options.listen.empty() ? PageAddress{} : parse_page_address(options.listen).or_throw();
  auto listener = PageListener::open(
      address, options.listen.empty() ? PageListener::TakenPort::next : PageListener::TakenPort::refuse);
  PageServer::Config config{make_page_token()};
  const std::string where = "http://" + (listener ? listener->address().text() : "") + "/#token=" + config.token;
  PageServer server(loop, std::move(listener).or_throw(), std::move(config), source);
  const SignalWatch interrupted(loop, SIGINT, [&] { loop.stop(); });
  const SignalWatch ended(loop, SIGTERM, [&] { loop.stop(); });
  err << "rtdata: page of " << options.database << ": " << where << "\nrtdata: Ctrl-C ends it" << std::endl;
  ::signal(SIGPIPE, SIG_IGN);
  loop.run();
  return 0;
} catch (const SetupError& error) {
  print_error(err, error.error());
  return status_after(error.error());
}

}  // namespace rtdata::app
