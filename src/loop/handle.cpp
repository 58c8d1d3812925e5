#include "rtdata/loop/handle.hpp"

#include <mutex>

#include "loop/callback_survey.hpp"
#include "loop/loop_core.hpp"

namespace rtdata::detail {

void LoopCore::link(Node& node) noexcept {
  node.next_ = nodes_;
  if (nodes_ != nullptr) nodes_->previous_ = &node;
  nodes_ = &node;
}

void LoopCore::unlink(Node& node) noexcept {
  for (const auto& survey : surveys_) {
    if (survey->next_ == &node) survey->next_ = node.next_;
  }
  {
    const std::lock_guard lock(doing_mutex_);
    if (doing_.load(std::memory_order_relaxed) == &node) doing_.store(nullptr, std::memory_order_relaxed);
  }
  if (node.previous_ != nullptr) node.previous_->next_ = node.next_;
  if (node.next_ != nullptr) node.next_->previous_ = node.previous_;
  if (nodes_ == &node) nodes_ = node.next_;
  node.previous_ = node.next_ = nullptr;
}

Node::Node(LoopCore& loop) : loop_(&loop) {
  if (loop.runs_elsewhere()) {
    throw SetupError({Errc::busy, "cannot make an object", "loop " + loop.config.name, "it runs on a thread of its own",
                      "make it before the tier runs, or with tier.call([](rtdata::Loop& loop) { ... })"});
  }
  loop.check_thread("cannot make an object", "");
  loop.link(*this);
}
Node::~Node() {
  if (loop_ != nullptr) loop_->unlink(*this);  // a constructor of a derived class threw
}

void Node::dispose() noexcept {
  LoopCore* const loop = loop_;
  if (loop != nullptr && loop->runs_elsewhere()) {
    loop->call_there([this] { dispose(); });
    return;
  }
  close();
  release();
}

void Node::close() noexcept {
  if (loop_ == nullptr || is_closing_) return;
  is_closing_ = true;  // closing may report, and the handler of the report may close it once more
  on_close();
  loop_->unlink(*this);
  loop_ = nullptr;
  if (running_ == 0) drop_callbacks();
}

}  // namespace rtdata::detail
