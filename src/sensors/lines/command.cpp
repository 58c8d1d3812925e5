#include "rtdata/sensors/command.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "data/setting_mistake.hpp"
#include "io/child_process.hpp"
#include "loop/events/allowance.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "sensors/lines/line_node.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr Duration starting_limit = std::chrono::seconds{5};
// A program that ends also closes its output; both are noticed within this time.
constexpr Duration ending_limit = std::chrono::milliseconds{200};
constexpr std::size_t longest_error_line = 500;
constexpr const char* program_advice = "check the program: `run` it by hand";

}  // namespace

class CommandNode final : public LineNode {
 public:
  CommandNode(LoopCore& loop, const FeedConfig& feed, CommandConfig config)
      : LineNode(loop, feed, std::move(config.lines), config.run.front(), program_advice),
        run_(std::move(config.run)),
        is_terminal_(config.pty),
        lane_(std::in_place, loop, "program of " + feed.name, starting_limit),
        over_(loop.face, [this] { be_over(); }) {
    set_stream();
  }

 private:
  class Starting final : public LaneJob {
   public:
    explicit Starting(CommandNode& node) : node_(&node), run_(node.run_), is_terminal_(node.is_terminal_) {}
    void run() noexcept override {
      try {
        child_ = start_child(run_, is_terminal_ ? ChildPrints::to_terminal : ChildPrints::to_pipe);
      } catch (const std::exception& error) {
        child_ = Error{Errc::io_failed, "cannot start the program", run_.front(), error.what(), ""};
      }
    }
    void done(Outcome outcome) override {
      CommandNode* const node = std::exchange(node_, nullptr);
      if (node == nullptr) return end();
      node->starting_ = nullptr;
      if (outcome == Outcome::finished) return node->started(std::exchange(child_, Child{}));
      node->take(Error{Errc::timed_out, "cannot start the program", run_.front(),
                       "it did not start within " + to_string(starting_limit), "check the disk of the program"});
    }
    /// The node stops or is closed.
    void forget() noexcept { node_ = nullptr; }
    /// Also ends a program that was started too late.
    ~Starting() override { end(); }

   private:
    void end() noexcept {
      if (child_ && child_->pid > 0) end_child(*child_);
      child_ = Child{};
    }
    CommandNode* node_;
    const std::vector<std::string> run_;
    const bool is_terminal_;
    Result<Child> child_ = Child{};
  };
  void open_stream() override {
    const auto job = std::make_shared<Starting>(*this);
    starting_ = job;
    if (lane_->submit(job, starting_limit)) return;
    starting_ = nullptr;
    take(Error{Errc::timed_out, "cannot start the program", place(), "no thread is free: earlier attempts still hang",
               "check the disk of the program"});
  }
  void started(Result<Child> child) {
    if (!child) return take(std::move(child).error());
    child_ = *child;
    is_output_over_ = has_ended_ = false;
    last_error_.clear();
    error_text_.clear();
    errors_ = FdWatch(loop()->face, child_.errors, FdWatch::readable, object_name(),
                      [this](const FdEvent&) { take_errors(); });
    ended_ = FdWatch(loop()->face, child_.ended, FdWatch::readable, object_name(), [this](const FdEvent&) {
      ended_.close();
      has_ended_ = true;
      note_end();
    });
    take(child_.output);
  }
  void close_stream() noexcept override {
    if (starting_ != nullptr) std::exchange(starting_, nullptr)->forget();
    LineNode::close_stream();
  }
  /// Also ends the program.
  void close_source(int) noexcept override {
    over_.stop();
    errors_.close();
    ended_.close();
    if (const Child child = std::exchange(child_, Child{}); child.pid > 0) end_child(child);
  }
  void on_close() noexcept override {
    over_.close();
    LineNode::on_close();
    lane_.reset();  // it must not outlive the loop
  }

  void source_ended(int) override {
    pause_reading();
    is_output_over_ = true;
    note_end();
  }
  void note_end() {
    if (is_output_over_ && has_ended_) return be_over();
    if (!over_.is_running()) over_.start(ending_limit);
  }
  void be_over() {
    if (child_.pid <= 0) return;
    Call call(*this);
    take_errors();
    say(std::exchange(error_text_, {}));
    std::string why = end_of(child_);
    if (why.empty()) why = "it has closed its output, so it is ended";
    if (!last_error_.empty()) why += "; it said: " + last_error_;
    lose({Errc::disconnected, "lost the program", place(), std::move(why), program_advice}, loop()->now());
  }

  /// The program's standard error is written to the log.
  void take_errors() {
    std::array<char, 1024> bytes{};
    const ssize_t got = child_.errors >= 0 ? ::read(child_.errors, bytes.data(), bytes.size()) : 0;
    if (got < 0 && (errno == EAGAIN || errno == EINTR)) return;
    if (got <= 0) return errors_.close();
    std::string_view text(bytes.data(), static_cast<std::size_t>(got));
    for (std::size_t end = text.find('\n'); end != std::string_view::npos; end = text.find('\n')) {
      error_text_.append(text.substr(0, std::min(end, longest_error_line)));
      text.remove_prefix(end + 1);
      say(std::exchange(error_text_, {}));
    }
    if (error_text_.size() < longest_error_line) error_text_.append(text.substr(0, longest_error_line));
  }
  void say(std::string line) {
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.pop_back();
    if (line.empty()) return;
    for (char& c : line)
      if (static_cast<unsigned char>(c) < ' ') c = ' ';
    if (line.size() > longest_error_line) line.resize(longest_error_line);
    last_error_ = line;
    const Duration now = loop()->now().time_since_epoch();
    if (!allowance_.has_some(now)) {
      ++left_out_;
      return;
    }
    allowance_.spend(now);
    const unsigned left_out = std::exchange(left_out_, 0);
    loop()->runtime.log(
        LogLevel::warning, object_name(),
        "the program says: " + line +
            (left_out > 0 ? " (earlier lines that are not shown: " + std::to_string(left_out) + ")" : ""));
  }
  const std::vector<std::string> run_;
  const bool is_terminal_;
  std::optional<Lane> lane_;  // until it is closed
  std::shared_ptr<Starting> starting_;
  Child child_;
  FdWatch errors_, ended_;
  Timer over_;
  bool is_output_over_ = false, has_ended_ = false;
  std::string error_text_, last_error_;
  Allowance allowance_;
  unsigned left_out_ = 0;  // lines of its standard error, since the last that was logged
};

}  // namespace detail

void check_config(const CommandConfig& config, const ConfigItem& item, Problems& problems) {
  const bool has_nul = std::any_of(config.run.begin(), config.run.end(),
                                   [](const std::string& word) { return word.find('\0') != std::string::npos; });
  if (has_nul)
    detail::add_mistake({"run", "a word contains a byte 0, which would end it", "remove it"}, item, problems);
  if (config.run.empty() || config.run.front().empty())
    detail::add_mistake({"run", "it names no program", "write one, such as [\"python3\", \"hx711.py\"]"}, item,
                        problems);
  detail::add_mistake(detail::mistake_in_program(config.run), item, problems);
  check_config(config.lines, item, problems);
}

ReadTime read_time(const CommandConfig& config) { return read_time(config.lines); }

CommandSensor::CommandSensor(Loop& loop, FeedConfig feed, CommandConfig config) {
  const auto refuse = [&](const char* why, const char* what_helps) {
    throw SetupError({Errc::bad_argument, "cannot use this program", "sensor " + feed.name, why, what_helps});
  };
  if (config.run.empty() || config.run.front().empty())
    refuse("`run` names no program", "set it, such as {\"python3\", \"x.py\"}");
  detail::check_source(config.lines, feed.name);
  const bool starts = config.lines.start;
  auto* node = new detail::CommandNode(loop.core(), feed, std::move(config));
  CommandSensor made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
