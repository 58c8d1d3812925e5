#include "rtdata/sensors/feed.hpp"

#include "sensors/core/feed_node.hpp"

namespace rtdata {
namespace detail {

Node* make_feed(Loop& loop, FeedConfig config, PayloadType type) {
  return new FeedNode(loop.core(), config, std::move(type));
}

namespace {

/// Null when it is closed.
FeedNode* feed(Node* node) {
  if (node == nullptr || !node->is_open()) return nullptr;
  auto* const feed = static_cast<FeedNode*>(node);
  feed->check_thread();
  return feed;
}

}  // namespace

void feed_publish(Node* node, const void* payload) {
  FeedNode* const to = feed(node);
  if (to != nullptr && to->is_running()) to->publish(const_cast<void*>(payload));
}

void feed_publish(Node* node, const void* payload, Time time) {
  FeedNode* const to = feed(node);
  if (to != nullptr && to->is_running()) to->publish(const_cast<void*>(payload), time);
}

}  // namespace detail

namespace {

using detail::feed;

/// A payload of another size is unreadable.
bool has_size(detail::Node* node, std::span<const std::byte> payload) {
  detail::FeedNode* to = feed(node);
  if (to == nullptr || payload.size() == to->payload_size()) return to != nullptr;
  to->fail_size(payload.size());
  return false;
}

}  // namespace

AnyFeed::AnyFeed(Loop& loop, FeedConfig config, std::shared_ptr<const Description> description)
    : AnySensor(detail::make_feed(loop, std::move(config), detail::described_type(std::move(description)))) {}
void AnyFeed::publish_bytes(std::span<const std::byte> payload) {
  if (has_size(node(), payload)) detail::feed_publish(node(), payload.data());
}
void AnyFeed::publish_bytes(std::span<const std::byte> payload, Time time) {
  if (has_size(node(), payload)) detail::feed_publish(node(), payload.data(), time);
}
void AnyFeed::fail(const Error& error) {
  if (auto* f = feed(node())) f->fail(error);
}
void AnyFeed::fault(const Error& error) {
  if (auto* f = feed(node())) f->fault(error);
}
void AnyFeed::repeated() {
  if (auto* f = feed(node())) f->repeated();
}
void AnyFeed::lost(std::uint64_t count) {
  if (auto* f = feed(node())) f->lost(count);
}
void AnyFeed::set_numbered() {
  if (auto* f = feed(node())) f->set_numbered();
}

}  // namespace rtdata
