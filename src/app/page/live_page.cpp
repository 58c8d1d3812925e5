#include "app/page/live_page.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <system_error>

#include "app/page/disk_work.hpp"
#include "app/page/mailbox.hpp"
#include "app/page/page_setup.hpp"
#ifdef RTDATA_WITH_SQLITE
#include "app/page/page_history.hpp"
#endif
#include "rtdata/loop/clock.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::uint64_t status_client = ~std::uint64_t{0};  // clients of the control socket count from 1
constexpr Duration step = std::chrono::milliseconds{250};   // of live events
constexpr Duration stream_pace = std::chrono::milliseconds{50};
constexpr Duration machine_pace = std::chrono::seconds{2};  // of the disk and the clock
constexpr Duration thread_patience = std::chrono::seconds{2};
constexpr Duration start_patience = std::chrono::seconds{10};
constexpr std::size_t most_read = std::size_t{1} << 20;  // of a stream in a turn

std::string content_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw SetupError(system_error(errno, "cannot serve the page", path));
  return {std::istreambuf_iterator<char>(file), {}};
}

}  // namespace

/// The data that depends on the configuration.
struct LivePage::Setup {
  std::string about;
  std::vector<std::string> changes;  // topics
  std::vector<Readers::Recording> recordings;
  std::vector<std::string> commands;
};

/// The data shared by the main loop and the thread, either of which may end later.
struct LivePage::Shared {
  Mailbox<LivePage> main;
  Mailbox<Source> page;
};

/// The thread's side.
class LivePage::Source final : public PageSource {
 public:
  Source(Loop& loop, std::shared_ptr<Shared> shared, Duration to_time, Setup setup)
      : loop_(loop), shared_(std::move(shared)), to_time_(to_time), setup_(std::move(setup)), disk_(loop, "page") {}
  /// From now on it gets the functions of the main loop.
  void open(PageServer& server) {
    server_ = &server;
    from_main_ = shared_->page.open(loop_, *this);
  }

  void begin() override {
    steps_.open(*this, {"#"}, step);
    changes_.open(*this, setup_.changes, Duration{0});
  }
  void end() override {
    steps_.close();
    changes_.close();
    on_main([](LivePage& page) { page.asks_.status->forget(status_client); });
  }
  void lines(const std::function<void(std::string_view)>& take) override {
    for (Stream* one : {&steps_, &changes_})
      if (!one->read(take) && loop_.now() - one->opened_at > std::chrono::seconds{1}) {  // the stream is not there
        end();
        begin();
        break;
      }
    for (const std::string& line : told_) take(line);
    told_.clear();
    look_at_machine();
  }
  std::string about() override { return setup_.about; }

  void status(Told told) override {
    const std::uint64_t number = remember(std::move(told));
    on_main([number](LivePage& page) {
      auto status = std::make_shared<Status>(page.asks_.status->take(status_client));
      page.shared_->page.put([status, number](Source& source) { source.tell(number, json_of(*status)); });
    });
  }
  void history([[maybe_unused]] std::string request, Told told) override {
#ifdef RTDATA_WITH_SQLITE
    std::vector<PageRecording> recordings;
    for (const Readers::Recording& one : setup_.recordings) recordings.push_back({one.sink, one.path, one.topics});
    disk_.submit([recordings = std::move(recordings),
                  request = std::move(request)] { return page_history(recordings, std::nullopt, request); },
                 std::move(told));
#else
    told(R"({"error":"this program was built without SQLite: nothing is recorded"})");
#endif
  }
  void command(std::vector<std::string> words, std::string by, Told told) override {
    const std::uint64_t number = remember(std::move(told));
    on_main([number, words = std::move(words), by = std::move(by)](LivePage& page) {
      page.asks_.command(words, by, [shared = page.shared_, number](std::string text) {
        shared->page.put([number, text = std::move(text)](Source& source) { source.tell(number, text); });
      });
    });
  }

  void stop() { loop_.stop(); }
  void set(Setup setup) {
    const bool has_other_changes = setup.changes != setup_.changes;
    setup_ = std::move(setup);
    server_->set_commands(setup_.commands);
    server_->tell_about();
    if (!has_other_changes || changes_.fd < 0) return;
    changes_.close();
    changes_.open(*this, setup_.changes, Duration{0});
  }

 private:
  /// A connection of the readers'.
  struct Stream {
    int fd = -1;
    std::string rest;
    MonotonicTime opened_at{};
    ~Stream() { close(); }
    void close() {
      if (fd >= 0) ::close(std::exchange(fd, -1));
      rest.clear();
    }
    void open(Source& source, std::vector<std::string> topics, Duration of_step) {
      opened_at = source.loop_.now();
      std::array<int, 2> ends{};
      if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, ends.data()) != 0) return;
      fd = ends[0];
      StreamRequest request;
      request.topics = std::move(topics);
      request.step = of_step;
      request.pace = stream_pace;
      source.on_main([theirs = ends[1], request = std::move(request)](LivePage& page) mutable {
        page.asks_.readers->add(theirs, std::move(request));
      });
    }
    /// False: it is not there.
    bool read(const std::function<void(std::string_view)>& take) {
      std::array<char, 16 << 10> buffer;
      for (std::size_t all = 0; fd >= 0 && all < most_read;) {
        const ssize_t size = ::read(fd, buffer.data(), buffer.size());
        if (size < 0 && errno == EINTR) continue;
        if (size == 0) close();
        if (size <= 0) break;
        all += static_cast<std::size_t>(size);
        rest.append(buffer.data(), static_cast<std::size_t>(size));
      }
      std::size_t begin = 0;
      for (std::size_t end = rest.find('\n'); end != std::string::npos; end = rest.find('\n', begin)) {
        take(std::string_view(rest).substr(begin, end - begin));
        begin = end + 1;
      }
      rest.erase(0, begin);
      return fd >= 0;
    }
  };

  template <class Function>
  void on_main(Function function) {
    shared_->main.put(std::move(function));
  }
  std::uint64_t remember(Told told) {
    waiting_[++last_] = std::move(told);
    return last_;
  }
  void tell(std::uint64_t number, std::string text) {
    const auto found = waiting_.find(number);
    if (found == waiting_.end()) return;
    const Told told = std::move(found->second);
    waiting_.erase(found);
    told(std::move(text));
  }

  /// The free space of the disks, and the accuracy of UTC.
  void look_at_machine() {
    if (is_looking_ || loop_.now() - looked_at_ < machine_pace) return;
    is_looking_ = true;
    looked_at_ = loop_.now();
    std::vector<std::pair<std::string, std::string>> files;
    for (const Readers::Recording& one : setup_.recordings) files.emplace_back(one.sink, one.path);
    disk_.submit(
        [files = std::move(files), to_time = to_time_] {
          SystemClock clock;
          const Time now{std::chrono::steady_clock::now().time_since_epoch() + to_time};
          Json told{{"now", std::chrono::duration<double, std::milli>(now.time_since_epoch()).count()},
                    {"clock",
                     {{"offset", std::chrono::duration<double, std::milli>(clock.realtime() - now).count()},
                      {"source", "system"},
                      {"accuracy", nullptr}}},
                    {"disks", Json::array()}};
          if (const auto accuracy = clock.accuracy())
            told["clock"]["accuracy"] = std::chrono::duration<double>(*accuracy).count();
          for (const auto& [sink, path] : files) {
            std::error_code none;
            double bytes = 0;
            for (const char* more : {"", "-wal"}) {
              const auto size = std::filesystem::file_size(path + more, none);
              if (!none) bytes += static_cast<double>(size);
            }
            const auto folder = std::filesystem::absolute(path, none).parent_path();
            const auto space = std::filesystem::space(folder, none);
            if (!none)
              told["disks"].push_back(
                  {{"sink", sink}, {"path", path}, {"bytes", bytes}, {"free", static_cast<double>(space.available)}});
          }
          return "{\"machine\":" + told.dump(-1, ' ', false, Json::error_handler_t::replace) + "}";
        },
        [this](std::string line) {
          is_looking_ = false;
          told_.push_back(std::move(line));
        });
  }

  Loop& loop_;
  const std::shared_ptr<Shared> shared_;
  PageServer* server_ = nullptr;
  FdWatch from_main_;
  const Duration to_time_;
  Setup setup_;
  Stream steps_, changes_;
  std::map<std::uint64_t, Told> waiting_;
  std::uint64_t last_ = 0;
  std::vector<std::string> told_;  // lines
  bool is_looking_ = false;
  MonotonicTime looked_at_{};
  DiskWork disk_;
};

LivePage::Setup LivePage::setup_of(const SystemPlan& plan) {
  Setup setup{page_setup(plan), topics_of_changes(plan), {}, {}};
  for (const PartPlan& part : plan.parts)
    if (part.stores && part.stores->is_recording)
      setup.recordings.push_back({part.name, part.stores->path, part.stores->topics});
  if (plan.settings.page) setup.commands = plan.settings.page->commands;
  return setup;
}

LivePage::LivePage(Loop& loop, Config config, const SystemPlan& plan, Asks asks)
    : asks_(std::move(asks)), shared_(std::make_shared<Shared>()) {
  PageServer::Config served{config.token, config.settings.commands, config.settings.names};
  if (const auto& tls = config.settings.tls) {
    served.certificate = content_of(tls->certificate);
    served.key = content_of(tls->key);
  }
  address_ = (config.settings.tls ? "https://" : "http://") + config.listener.address().text() + "/";
  keep_address(config.socket_path, config.token);
  const Duration to_time = loop.time().time_since_epoch() - loop.now().time_since_epoch();
  std::promise<void> ended;
  ended_ = ended.get_future();
  std::promise<std::string> started;
  std::future<std::string> failed = started.get_future();
  const auto serve = [shared = shared_, to_time, setup = setup_of(plan),
                      listener = std::make_shared<PageListener>(std::move(config.listener)), served,
                      started = std::make_shared<std::promise<std::string>>(std::move(started)),
                      ended = std::make_shared<std::promise<void>>(std::move(ended))]() mutable {
    bool has_started = false;
    try {
      ::setpriority(PRIO_PROCESS, 0, 19);  // of this thread alone, as Linux has it; and so of its lane's
      Loop own({.name = "page", .hold_limit = std::chrono::hours{1}});
      Source source(own, shared, to_time, std::move(setup));
      PageServer server(own, std::move(*listener), std::move(served), source);
      source.open(server);
      has_started = true;
      started->set_value("");
      own.run();
    } catch (const std::exception& error) {  // no memory, no descriptors
      if (!has_started) started->set_value(std::string(detail::reason_of(error)));
    }
    ended->set_value();
  };
  try {
    thread_ = std::thread(serve);
  } catch (const std::system_error& error) {
    throw SetupError(system_error(error.code().value(), "cannot serve the page", "thread"));
  }
  const bool has_answered = failed.wait_for(start_patience) == std::future_status::ready;
  const std::string why = has_answered ? failed.get() : "the thread of the page did not get the processor";
  if (why.empty()) {
    from_page_ = shared_->main.open(loop, *this);
    return;
  }
  has_answered ? thread_.join() : thread_.detach();
  if (!file_.empty()) ::unlink(file_.c_str());
  throw SetupError({Errc::io_failed, "cannot serve the page", address_, why, ""});
}

LivePage::~LivePage() {
  from_page_.close();
  if (!file_.empty()) ::unlink(file_.c_str());
  shared_->page.put([](Source& source) { source.stop(); });
  if (ended_.wait_for(thread_patience) == std::future_status::ready) {
    thread_.join();
  } else {
    thread_.detach();  // the thread did not get the processor; it touches only shared data
  }
}

void LivePage::set(const SystemPlan& plan) {
  shared_->page.put([setup = setup_of(plan)](Source& source) { source.set(setup); });
}

/// In "PID.page" beside the socket, whose folder is this user's alone. Removes those of programs that have ended.
void LivePage::keep_address(const std::string& socket_path, const std::string& token) {
  if (socket_path.empty()) return;
  const std::filesystem::path folder = std::filesystem::path(socket_path).parent_path();
  std::error_code none;
  for (const auto& entry : std::filesystem::directory_iterator(folder, none)) {
    if (entry.path().extension() != ".page") continue;
    const int pid = std::atoi(entry.path().stem().c_str());
    if (pid > 0 && (pid == ::getpid() || (::kill(pid, 0) != 0 && errno == ESRCH))) ::unlink(entry.path().c_str());
  }
  const std::string path = folder / (std::to_string(::getpid()) + ".page");
  const int fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0600);
  const std::string text = address_ + "#token=" + token + "\n";
  const bool is_kept = fd >= 0 && ::write(fd, text.data(), text.size()) == static_cast<ssize_t>(text.size());
  const int error = errno;
  if (fd >= 0) ::close(fd);
  if (!is_kept) throw SetupError(system_error(error, "cannot keep the address of the page", path));
  file_ = path;
}

}  // namespace rtdata::app
