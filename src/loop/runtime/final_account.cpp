#include "loop/runtime/final_account.hpp"

#include <algorithm>
#include <array>
#include <string_view>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/support/fitting.hpp"
#include "rtdata/loop/account.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::detail {
namespace {

template <std::size_t N>
text<N> fitting(std::string_view content) {
  std::array<char, N> bytes;
  return text<N>(std::string_view(bytes.data(), put_fitting(bytes.data(), N, content)));
}

}  // namespace

void publish_final_account(LoopCore& loop) noexcept try {
  RuntimeCore& runtime = loop.runtime;
  const bool is_wanted = runtime.find_topic(account_topic) != nullptr ||
                         std::any_of(runtime.recorders.begin(), runtime.recorders.end(),
                                     [](const Recorder* recorder) { return recorder->wants(account_topic); });
  if (!is_wanted) return;
  const auto sensors = loop.face.runtime().sensors();
  TopicCore& topic = runtime.topic(account_topic, payload_type<FinalCounts>());
  for (const SensorStatus& sensor : sensors) {
    if (sensor.topic == account_topic) continue;
    FinalCounts account;
    account.name = fitting<200>(sensor.name);
    account.topic = fitting<200>(sensor.topic);
    account.published = sensor.counts.published;
    account.late = sensor.counts.late;
    account.missed = sensor.counts.missed;
    account.failed = sensor.counts.failed;
    account.unreadable = sensor.counts.unreadable;
    account.lost = sensor.counts.lost;
    account.lost_is_known = sensor.counts.lost_is_known;
    publish_from_program(topic, &account);
  }
  loop.deliver_all();
} catch (...) {  // no memory; or the program uses the name for another topic
}

}  // namespace rtdata::detail
