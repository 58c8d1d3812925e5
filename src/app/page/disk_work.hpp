// Reads disks for a page, off its loop.
#pragma once

#include <exception>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "app/page/page_server.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata::app {

/// Runs blocking work on its own lane, and passes the resulting text, or the error, to the loop. After its destruction
/// it passes nothing. Owner: the holder. Thread: the loop's.
class DiskWork {
 public:
  DiskWork(Loop& loop, std::string name) : lane_(loop.core(), std::move(name), std::chrono::seconds{30}) {}
  DiskWork(const DiskWork&) = delete;
  DiskWork& operator=(const DiskWork&) = delete;
  ~DiskWork() {
    *is_here_ = false;
    lane_.abandon_thread();
  }

  void submit(std::function<std::string()> work, PageSource::Told told) {
    const auto job = std::make_shared<Job>(std::move(work), told, is_here_);
    if (!lane_.submit(job)) told(R"({"error":"the disk does not answer"})");
  }

 private:
  struct Job final : detail::LaneJob {
    Job(std::function<std::string()> work_, PageSource::Told told_, std::shared_ptr<bool> is_here_)
        : work(std::move(work_)), told(std::move(told_)), is_here(std::move(is_here_)) {}
    void run() noexcept override try { text = work(); } catch (const std::exception& error) {
      using Json = nlohmann::ordered_json;
      text = Json{{"error", detail::reason_of(error)}}.dump(-1, ' ', false, Json::error_handler_t::replace);
    }
    void done(Outcome outcome) override {
      if (*is_here) told(outcome == Outcome::finished ? text : R"({"error":"the disk did not answer in time"})");
    }
    const std::function<std::string()> work;
    const PageSource::Told told;
    const std::shared_ptr<bool> is_here;
    std::string text;
  };
  std::shared_ptr<bool> is_here_ = std::make_shared<bool>(true);
  detail::Lane lane_;
};

}  // namespace rtdata::app
