// A sink of one's own: a Writer. The queue, batches, retries and the account come with `Sink`.
#include <cstdio>

#include "rtdata/loop/loop.hpp"
#include "rtdata/sensors/host.hpp"
#include "rtdata/sinks/sink.hpp"

using namespace rtdata::literals;

/// Writes `topic field=value,field=value time`, as time series databases read it.
class LineProtocol final : public rtdata::Writer {
 public:
  explicit LineProtocol(std::string path) : path_(std::move(path)) {}
  ~LineProtocol() override {
    if (file_ != nullptr) std::fclose(file_);
  }

  rtdata::Result<void> open() override {  // before the first batch, and again after a failure
    if (file_ == nullptr) file_ = std::fopen(path_.c_str(), "ae");
    if (file_ == nullptr) return rtdata::system_error(errno, "cannot open the file", path_);
    return {};
  }
  rtdata::Result<void> write(rtdata::Batch& batch) override {  // on the sink's own thread: it may block
    std::string text;
    for (const rtdata::Record& record : batch) {
      char separator = ' ';
      text += record.info->topic;
      for (const rtdata::Leaf& leaf : record.info->description->leaves()) {
        text += separator + leaf.path + "=" + rtdata::to_string(record.view().value(leaf));
        separator = ',';
      }
      text += " " + std::to_string(rtdata::to_nanoseconds(record.header.time)) + "\n";
    }
    if (std::fwrite(text.data(), 1, text.size(), file_) != text.size() || std::fflush(file_) != 0) {
      return rtdata::system_error(errno, "cannot write the file", path_);
    }
    return {};
  }

 private:
  std::string path_;
  std::FILE* file_ = nullptr;
};

int main() {
  rtdata::Loop loop;
  rtdata::Sink sink(loop, {.name = "lines", .batch_time = 100ms}, std::make_unique<LineProtocol>("lines.txt"));
  rtdata::HostSensor load(loop, {.name = "load", .topic = "host/load", .rate = 20_Hz},
                          {.quantity = rtdata::HostQuantity::load});
  loop.run_for(500ms);
  const std::uint64_t lost = loop.close();
  const rtdata::SinkCounts counts = loop.runtime().sinks().at(0).counts;
  std::printf("%d lines in lines.txt\n", static_cast<int>(counts.stored));
  return lost == 0 && counts.stored > 0 && loop.runtime().balances() ? 0 : 1;
}
