#include "loop/core/nodes.hpp"

#include <algorithm>
#include <utility>

#include "loop/core/callback_survey.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/core/virtual_threads.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

void Nodes::link(Node& node) noexcept {
  node.next_ = first_;
  if (first_ != nullptr) first_->previous_ = &node;
  first_ = &node;
}

void Nodes::unlink(Node& node) noexcept {
  for (const auto& survey : surveys_) {
    if (survey->next_ == &node) survey->next_ = node.next_;
  }
  {
    const std::lock_guard lock(doing_mutex_);
    if (doing_.load(std::memory_order_relaxed) == &node) doing_.store(nullptr, std::memory_order_relaxed);
  }
  if (node.previous_ != nullptr) node.previous_->next_ = node.next_;
  if (node.next_ != nullptr) node.next_->previous_ = node.previous_;
  if (first_ == &node) first_ = node.next_;
  node.previous_ = node.next_ = nullptr;
}

void Nodes::preempt() noexcept { threads_->preempt(); }

void Nodes::close_all() noexcept {
  while (first_ != nullptr) {
    Node* node = first_;
    node->retain();
    node->close();
    node->release();
  }
}

std::string Nodes::doing() const {
  const std::lock_guard lock(doing_mutex_);
  if (!does_.empty()) return does_;
  const Node* node = doing_.load(std::memory_order_acquire);
  return node != nullptr ? node->callback_name() : std::string();
}

std::vector<CallbackStatus> Nodes::callbacks() const {
  std::vector<CallbackStatus> all;
  for (const Node* node = first_; node != nullptr; node = node->next_) {
    CallbackStatus status;
    if (!node->report_times(status)) continue;
    status.place = loop_.runtime.reports.place_of(status.name);
    all.push_back(std::move(status));
  }
  std::reverse(all.begin(), all.end());
  return all;
}

std::shared_ptr<CallbackSurvey> Nodes::begin_survey() {
  auto survey = std::make_shared<CallbackSurvey>();
  loop_.post([this, survey] {
    surveys_.push_back(survey);
    survey->next_ = first_;
    go_on(survey);
  });
  return survey;
}

void Nodes::go_on(const std::shared_ptr<CallbackSurvey>& survey) {
  for (std::size_t i = 0; i < CallbackSurvey::most_in_turn && survey->next_ != nullptr; ++i) {
    const Node* node = std::exchange(survey->next_, survey->next_->next_);
    CallbackStatus status;
    if (!node->report_times(status) || status.times.count == 0) continue;
    status.place = loop_.runtime.reports.place_of(status.name);
    survey->callbacks_.push_back(std::move(status));
  }
  if (survey->next_ != nullptr) return loop_.post([this, survey] { go_on(survey); });
  std::erase(surveys_, survey);
  std::reverse(survey->callbacks_.begin(), survey->callbacks_.end());
  survey->done_.set();
}

}  // namespace rtdata::detail
