// The objects on a loop: their list, the one whose callback runs, and what their callbacks took.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "loop/core/priority_mutex.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/handle.hpp"

namespace rtdata::detail {

class CallbackSurvey;
class LoopCore;
class VirtualThreads;

class Nodes {
 public:
  Nodes(LoopCore& loop, VirtualThreads* threads) noexcept : loop_(loop), threads_(threads) {}

  // The loop's thread
  void link(Node& node) noexcept;
  void unlink(Node& node) noexcept;
  void close_all() noexcept;
  /// Notes that a callback of the node begins; null: a callback without a name.
  void begins(const Node* node) noexcept {
    doing_.store(node, std::memory_order_release);
    if (threads_ != nullptr) [[unlikely]]
      preempt();
  }
  /// Changes a name while `doing` may read it.
  void rename(std::string& name, std::string to) noexcept {
    const std::lock_guard lock(doing_mutex_);
    name.swap(to);
  }
  /// Sets the text of `doing` while it lives, for work that may hold the loop but is not a callback, such as making a
  /// part.
  class Doing {
   public:
    Doing(Nodes& nodes, std::string what) : nodes_(nodes) { nodes_.rename(nodes_.does_, std::move(what)); }
    Doing(const Doing&) = delete;
    Doing& operator=(const Doing&) = delete;
    ~Doing() { nodes_.rename(nodes_.does_, {}); }

   private:
    Nodes& nodes_;
  };
  std::vector<CallbackStatus> callbacks() const;

  // Any thread
  /// The name of the last callback begun; empty if unknown.
  std::string doing() const;
  std::shared_ptr<CallbackSurvey> begin_survey();

 private:
  void go_on(const std::shared_ptr<CallbackSurvey>& survey);

  /// In virtual time another loop may run first.
  void preempt() noexcept;

  LoopCore& loop_;
  VirtualThreads* const threads_;  // null in real time
  Node* first_ = nullptr;
  std::vector<std::shared_ptr<CallbackSurvey>> surveys_;  // under way
  std::atomic<const Node*> doing_{nullptr};
  std::string does_;                   // see Doing; empty: nothing
  mutable PriorityMutex doing_mutex_;  // prevents destroying a node that `doing` reads
};

}  // namespace rtdata::detail
