#include "rtdata/loop/handle.hpp"

#include <mutex>
#include <utility>

#include "loop/callback_survey.hpp"
#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"

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

void LoopCore::check_not_ending(const char* what) const {
  if (!is_ending_) return;
  throw SetupError(
      {Errc::busy, what, "loop " + config.name, "it is being destroyed",
       "make and run nothing in what runs while a loop ends: destructors of captures, `close` of devices"});
}

void refuse_empty(const char* what, std::string_view name) {
  throw SetupError({Errc::bad_argument, what, std::string(name), "there is nothing to be called: its function is empty",
                    "give it a function"});
}

Node::Node(LoopCore& loop) : loop_(&loop) {
  if (loop.runs_elsewhere()) {
    throw SetupError({Errc::busy, "cannot make an object", "loop " + loop.config.name, "it runs on a thread of its own",
                      "make it before the tier runs, or with tier.call([](rtdata::Loop& loop) { ... })"});
  }
  loop.check_thread("cannot make an object", "");
  loop.check_not_ending("cannot make an object");
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
  if (loop != nullptr && loop->is_run_by_another_thread()) return loop->dispose_later(*this);
  close();
  release();
}

void Node::close() noexcept {
  if (loop_ == nullptr || is_closing_) return;
  is_closing_ = true;  // closing may report, and the handler of the report may close it once more
  retain();            // or let go of it
  on_close();
  loop_->unlink(*this);
  loop_ = nullptr;
  if (running_ == 0) drop_callbacks();
  release();
}

void LoopCore::dispose_later(Node& node) noexcept {
  struct Owned {
    explicit Owned(Node& node) noexcept : node_(&node) {}
    Owned(Owned&& other) noexcept : node_(std::exchange(other.node_, nullptr)) {}
    ~Owned() {
      if (node_ == nullptr) return;
      node_->close();
      node_->release();
    }
    Node* node_;
  };
  post([this, owned = Owned(node)] {
    const std::string name = owned.node_->callback_name();
    owned.node_->close();
    runtime.report(this, name.empty() ? "loop " + config.name : name,
                   {Errc::busy, "was closed where it may not be", "loop " + config.name,
                    "another thread did it, or a call of a sink's writer; it is closed now, by its loop",
                    "post a function to the loop that closes it there"});
  });
}

}  // namespace rtdata::detail
