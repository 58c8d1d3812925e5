#include "rtdata/loop/handle.hpp"

#include <chrono>

#include "loop/core/loop_core.hpp"

namespace rtdata::detail {

void refuse_empty(const char* what, std::string_view name) {
  throw SetupError({Errc::bad_argument, what, std::string(name), "its function is empty", "give it a function"});
}

Node::Node(LoopCore& loop) : loop_(&loop) {
  if (loop.runs_elsewhere()) {
    throw SetupError({Errc::busy, "cannot make an object", "loop " + loop.config.name, "it runs on a thread of its own",
                      "make it before the tier runs, or with tier.call([](rtdata::Loop& loop) { ... })"});
  }
  loop.check_thread("cannot make an object", "");
  loop.check_not_ending("cannot make an object");
  loop.nodes.link(*this);
}
Node::~Node() {
  if (loop_ != nullptr) loop_->nodes.unlink(*this);  // a constructor of a derived class threw
}

void Node::dispose() noexcept {
  LoopCore* const loop = loop_;
  if (loop != nullptr && loop->runs_elsewhere()) {
    // A longer limit than for other calls, because objects used by its callbacks may be destroyed after this.
    const auto closed = loop->call_there_within(
        std::chrono::seconds{5}, [this] { dispose(); }, LoopCore::Begun::is_given_up);
    if (closed == LoopCore::Called::not_begun) loop->dispose_when_it_turns(*this);
    return;
  }
  if (loop != nullptr && loop->is_run_by_another_thread()) return loop->dispose_later(*this);
  close();
  release();
}

void Node::close() noexcept {
  if (loop_ == nullptr || is_closing_) return;
  is_closing_ = true;  // closing may report, and the report's handler may close it again
  retain();            // or destroy the handle
  on_close();
  loop_->nodes.unlink(*this);
  loop_ = nullptr;
  if (running_ == 0) drop_callbacks();
  release();
}

}  // namespace rtdata::detail
