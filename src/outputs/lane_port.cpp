// An output's device in this program, set on a lane of its own.
#include <exception>
#include <optional>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "outputs/port.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata::detail {

Result<void> HeldActuator::put(std::optional<double> value) noexcept {
  constexpr const char* what = "cannot set the output";
  Error error{Errc::io_failed, what, "", "an exception", ""};
  try {
    Result<void> result;
    if (actuator_ != nullptr) {
      if (value) result = actuator_->set(*value);
    } else {
      auto made = make_ ? make_() : nullptr;
      if (made == nullptr) return Error{Errc::bad_argument, what, "", "no actuator was made", ""};
      result = made->open(value);
      if (result) actuator_ = std::move(made);
    }
    // An actuator that refuses a value keeps the device, with its value.
    if (!result && result.error().code != Errc::out_of_range) actuator_.reset();
    return result;
  } catch (const SetupError& thrown) {
    error = thrown.error();
  } catch (const std::exception& thrown) {
    error.why = reason_of(thrown);
  } catch (...) {
  }
  actuator_.reset();
  return error;
}

Result<void> HeldActuator::check() noexcept {
  auto* const checked = dynamic_cast<CheckedActuator*>(actuator_.get());
  if (checked == nullptr) return {};
  Error error{Errc::io_failed, "cannot set the output", "", "an exception", ""};
  try {
    Result<void> result = checked->check();
    if (!result) actuator_.reset();
    return result;
  } catch (const std::exception& thrown) {
    error.why = reason_of(thrown);
  } catch (...) {
  }
  actuator_.reset();
  return error;
}

namespace {

constexpr Duration longest_set = std::chrono::seconds{2};  // then the thread is abandoned

class LanePort final : public OutputPort {
 public:
  LanePort(Loop& loop, const std::string& name, MakeActuator make, Listener& listener)
      : name_(name),
        listener_(listener),
        held_(std::make_shared<HeldActuator>(std::move(make))),
        lane_(loop.core(), name, longest_set) {}
  ~LanePort() override {
    if (job_ != nullptr) job_->port = nullptr;
  }

  Result<void> open(std::optional<double> value) override { return hangs_ ? hanging() : held_->put(value); }
  Result<void> begin_open(std::optional<double> value) override { return submit(value, longest_wait, false); }
  Result<void> set(double value) override { return submit(value, longest_set, false); }
  Result<void> finish(std::optional<double> value) override {
    is_waiting_ = true;
    if (job_ != nullptr) lane_.wait(limit_);
    is_waiting_ = false;
    if (job_ != nullptr || hangs_) return hanging();
    Result<void> result;
    if (value) result = held_->put(value);
    held_->give_back();
    return result;
  }
  Result<void> begin_finish(std::optional<double> value) override {
    if (job_ == nullptr) return submit(value, longest_wait, true);
    end_ = End{value};  // after the running job
    return {};
  }
  Result<void> wait_for_end() override {
    is_waiting_ = true;
    const bool follows = end_.has_value();
    lane_.wait(limit_);
    if (follows && job_ != nullptr) lane_.wait(longest_wait);
    is_waiting_ = false;
    return job_ != nullptr || end_ ? hanging() : std::move(answer_);
  }

 private:
  struct Job final : LaneJob {
    void run() noexcept override {
      if (value || !is_last) result = held->put(value);
      if (is_last) held->give_back();
    }
    void done(Outcome outcome) override {
      if (port != nullptr) port->done(outcome, std::move(result));
    }
    LanePort* port = nullptr;  // null: it has gone
    std::shared_ptr<HeldActuator> held;
    std::optional<double> value;
    bool is_last = false;  // then the device is released
    Result<void> result;
  };
  struct End {
    std::optional<double> value;
  };

  Result<void> submit(std::optional<double> value, Duration limit, bool is_last) {
    if (hangs_) return hanging();
    limit_ = limit;
    auto job = std::make_shared<Job>();
    job->port = this;
    job->held = held_;
    job->value = value;
    job->is_last = is_last;
    job_ = job;
    if (lane_.submit(std::move(job), limit)) return {};
    job_ = nullptr;
    return hanging();
  }

  void done(LaneJob::Outcome outcome, Result<void> result) {
    job_.reset();
    hangs_ = outcome == LaneJob::Outcome::given_up;  // its thread may use the device at any later time
    if (outcome == LaneJob::Outcome::cancelled)
      result = Error{Errc::closed, "cannot set the output", name_, "the output is being closed", ""};
    const std::optional<End> end = std::exchange(end_, std::nullopt);
    if (end && outcome == LaneJob::Outcome::finished) {
      result = submit(end->value, longest_wait, true);
      if (result) return;
    }
    if (hangs_) result = hanging();
    if (is_waiting_)
      answer_ = std::move(result);
    else
      listener_.answered(std::move(result));
  }
  Error hanging() const {
    return {Errc::timed_out, "cannot set the output", name_,
            "its device did not return within " + to_string(limit_) + ", and nothing else can use it meanwhile",
            "check the device, and start the program again"};
  }

  const std::string name_;
  Listener& listener_;
  const std::shared_ptr<HeldActuator> held_;
  std::shared_ptr<Job> job_;      // under way
  Duration limit_ = longest_set;  // of that
  bool hangs_ = false;
  std::optional<End> end_;   // the next order
  bool is_waiting_ = false;  // on the loop, for the answer
  Result<void> answer_;
  Lane lane_;
};

}  // namespace

std::unique_ptr<OutputPort> make_lane_port(Loop& loop, const std::string& name, MakeActuator make,
                                           OutputPort::Listener& listener) {
  return std::make_unique<LanePort>(loop, name, std::move(make), listener);
}

}  // namespace rtdata::detail
