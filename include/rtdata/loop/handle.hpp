/// Handle: the common rules of all objects on a loop.
///
///  1. A handle is a move-only value, and owns the object behind it.
///  2. After the destructor or `close()` returns, its callback never runs again and the callback's captures are gone;
///     when that very callback is on the stack, its captures go as soon as it returns.
///  3. Any handle may be closed or destroyed from any callback, its own included.
///  4. A handle that outlives its loop becomes closed and harmless.
///  5. A moved-from handle is closed and harmless; a default-made one too.
///  6. Closing twice is the same as closing once.
///  7. On an attached loop nothing of the host is closed, stopped, walked or given data, whatever a handle does.
///  8. A callback may use every verb of its own and of other handles, move and assign them, and throw. Assigning closes
///     the old object after the handle has taken the new one: when callbacks of the old object assign to the handle
///     again, it keeps the last one assigned. A callback that runs, polls, advances or closes (`Loop::close`) its loop,
///     or makes an object on a loop that is being destroyed, gets SetupError (busy).
///
/// Code on a lane (every call of a sink's Writer) may only use `Loop::post` and `Loop::stop`: every other function
/// throws SetupError (busy). A handle that is closed or destroyed on a lane is closed by its loop in the loop's next
/// turn, and reported.
///
/// Thread: the loop's, for every member. A handle of a tier may also be closed or destroyed, and a sensor of a tier
/// used, from the main loop's thread while the tier runs: the call waits until the tier has done it (tier.hpp). Two
/// threads must not use the same handle at the same time.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

namespace rtdata {

class Loop;
struct CallbackStatus;

namespace detail {

class LoopCore;
class Nodes;

/// The object behind a handle. Owned by the handle and, while one of its callbacks runs, by that call; listed in its
/// loop.
class Node {
 public:
  explicit Node(LoopCore& loop);
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  void retain() noexcept { ++references_; }
  void release() noexcept {
    if (--references_ == 0) delete this;
  }
  bool is_open() const noexcept { return loop_ != nullptr; }
  LoopCore* loop() const noexcept { return loop_; }
  /// Closes it and drops the handle's reference. While its tier runs, the tier's thread does so and the caller waits.
  void dispose() noexcept;
  /// Ends all activity; the captures are destroyed now, or when the running callback returns.
  void close() noexcept;
  /// Fills in the name and times of its callbacks. False when it has none.
  virtual bool report_times(CallbackStatus&) const { return false; }
  /// The same name; empty when it has none. Any thread, as long as the node is listed in its loop.
  virtual std::string callback_name() const { return {}; }

 protected:
  virtual ~Node();
  /// Ends all activity. Called once, with `loop()` still set.
  virtual void on_close() noexcept = 0;
  /// Destroys the user's callbacks. Called once, when none of them is on the stack.
  virtual void drop_callbacks() noexcept = 0;

 private:
  friend class Call;
  friend class Nodes;
  // The members that each callback touches come last, next to those of the derived class, in one cache line.
  Node* previous_ = nullptr;
  Node* next_ = nullptr;
  LoopCore* loop_;
  std::uint32_t references_ = 1;
  std::uint16_t running_ = 0;  // calls on the stack
  bool is_closing_ = false;
};

/// SetupError (bad-argument): the caller gave an empty function.
[[noreturn]] void refuse_empty(const char* what, std::string_view name);

/// Brackets a call of a node's callback, so that the callback may close or destroy its own handle.
class Call {
 public:
  explicit Call(Node& node) noexcept : node_(node) {
    node_.retain();
    ++node_.running_;
  }
  Call(const Call&) = delete;
  Call& operator=(const Call&) = delete;
  ~Call() {
    if (--node_.running_ == 0 && !node_.is_open()) node_.drop_callbacks();
    node_.release();
  }

 private:
  Node& node_;
};

}  // namespace detail

class Handle {
 public:
  Handle() noexcept = default;
  Handle(Handle&& other) noexcept : node_(std::exchange(other.node_, nullptr)) {}
  Handle& operator=(Handle&& other) noexcept {
    // Closing the old object runs the user's code, which may use or destroy this handle, so it comes last.
    if (this != &other) const Handle old(std::exchange(node_, std::exchange(other.node_, nullptr)));
    return *this;
  }
  ~Handle() {
    while (node_ != nullptr) close();  // its callbacks may have assigned another object
  }

  /// Rule 2. Harmless on a closed handle.
  void close() noexcept {
    if (detail::Node* node = std::exchange(node_, nullptr)) {
      node->dispose();
    }
  }
  bool is_open() const noexcept { return node_ != nullptr && node_->is_open(); }
  explicit operator bool() const noexcept { return is_open(); }

 protected:
  explicit Handle(detail::Node* node) noexcept : node_(node) {}
  detail::Node* node() const noexcept { return node_; }

 private:
  detail::Node* node_ = nullptr;
};

}  // namespace rtdata
