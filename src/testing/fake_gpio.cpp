#include "rtdata/testing/fake_gpio.hpp"

#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <deque>

namespace rtdata {

class FakeGpio::Request final : public GpioRequest {
 public:
  Request(std::shared_ptr<std::mutex> mutex, std::shared_ptr<Chip> chip, unsigned number)
      : mutex_(std::move(mutex)),
        chip_(std::move(chip)),
        number_(number),
        generation_(chip_->generation),
        fd_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
    chip_->lines[number_].user = this;
  }
  ~Request() override {
    const std::lock_guard lock(*mutex_);
    if (has_chip()) {
      chip_->lines[number_].user = nullptr;
      chip_->lines[number_].consumer.clear();
    }
    ::close(fd_);
  }

  int value() noexcept override {
    const std::lock_guard lock(*mutex_);
    if (!has_chip()) return -ENODEV;
    return chip_->lines[number_].is_high != is_active_low ? 1 : 0;
  }
  int set(bool value) noexcept override {
    const std::lock_guard lock(*mutex_);
    if (!has_chip()) return ENODEV;
    chip_->lines[number_].is_high = value != is_active_low;
    return 0;
  }
  int descriptor() const noexcept override { return fd_; }
  int read(std::span<GpioRawEdge> edges) noexcept override {
    const std::lock_guard lock(*mutex_);
    if (!has_chip()) return -ENODEV;
    std::size_t count = 0;
    for (; count < edges.size() && !waiting_.empty(); ++count) {
      edges[count] = waiting_.front();
      waiting_.pop_front();
    }
    if (waiting_.empty()) {
      std::uint64_t seen = 0;
      [[maybe_unused]] const ssize_t got = ::read(fd_, &seen, sizeof seen);
    }
    return static_cast<int>(count);
  }
  bool is_there() noexcept override {
    const std::lock_guard lock(*mutex_);
    return has_chip();
  }

  // Under the lock.

  void wake() const {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t written = ::write(fd_, &one, sizeof one);
  }
  void edge(bool is_rising, MonotonicTime time, std::size_t kept, bool drops_oldest) {
    ++count_;
    if (waiting_.size() == kept) {
      if (!drops_oldest) return;
      waiting_.pop_front();
    }
    waiting_.push_back({is_rising, time.time_since_epoch().count(), count_});
    wake();
  }

  bool has_edges = false;
  GpioEdgeKind kind = GpioEdgeKind::both;
  bool is_active_low = false;

 private:
  bool has_chip() const noexcept { return chip_->is_there && chip_->generation == generation_; }

  const std::shared_ptr<std::mutex> mutex_;
  const std::shared_ptr<Chip> chip_;
  const unsigned number_;
  const unsigned generation_;
  const int fd_;
  std::uint32_t count_ = 0;
  std::deque<GpioRawEdge> waiting_;
};

FakeGpio::FakeGpio(Like like) : like_(like), kept_(like == Like::libgpiod_2 ? 1024 : 16) {}
FakeGpio::~FakeGpio() = default;

FakeGpio::Chip& FakeGpio::chip(const std::string& name) const {
  const auto found = std::find_if(chips_.begin(), chips_.end(), [&](const auto& one) { return one->name == name; });
  if (found == chips_.end()) throw SetupError({Errc::not_found, "there is no fake chip with this name", name, "", ""});
  return **found;
}

void FakeGpio::add_chip(const std::string& name, std::size_t lines, const std::string& prefix,
                        const std::string& label) {
  const std::lock_guard lock(*mutex_);
  auto made = std::make_shared<Chip>();
  made->name = name;
  made->label = label;
  made->lines.resize(lines);
  for (std::size_t i = 0; i < lines && !prefix.empty(); ++i) made->lines[i].name = prefix + std::to_string(i);
  chips_.push_back(std::move(made));
}

void FakeGpio::unplug(const std::string& name, bool hangs_up) {
  const std::lock_guard lock(*mutex_);
  Chip& gone = chip(name);
  gone.is_there = false;
  for (Line& line : gone.lines)
    if (Request* user = std::exchange(line.user, nullptr); user != nullptr && hangs_up) user->wake();
}

void FakeGpio::plug_in(const std::string& name) {
  const std::lock_guard lock(*mutex_);
  Chip& back = chip(name);
  back.is_there = true;
  ++back.generation;
  for (Line& line : back.lines) {
    line.user = nullptr;
    line.consumer.clear();
  }
}

void FakeGpio::refuse(const std::string& name, int error_number) {
  const std::lock_guard lock(*mutex_);
  chip(name).error_number = error_number;
}
void FakeGpio::occupy(const std::string& name, unsigned number, const std::string& consumer) {
  const std::lock_guard lock(*mutex_);
  chip(name).lines.at(number).consumer = consumer;
}
bool FakeGpio::level(const std::string& name, unsigned number) const {
  const std::lock_guard lock(*mutex_);
  return chip(name).lines.at(number).is_high;
}
bool FakeGpio::is_taken(const std::string& name, unsigned number) const {
  const std::lock_guard lock(*mutex_);
  return !chip(name).lines.at(number).consumer.empty();
}

void FakeGpio::drive(const std::string& name, unsigned number, bool is_high, MonotonicTime time) {
  const std::lock_guard lock(*mutex_);
  Line& line = chip(name).lines.at(number);
  if (std::exchange(line.is_high, is_high) == is_high) return;
  Request* const user = line.user;
  if (user == nullptr || !user->has_edges) return;
  const bool is_rising = is_high != user->is_active_low;
  if (user->kind == (is_rising ? GpioEdgeKind::falling : GpioEdgeKind::rising)) return;
  user->edge(is_rising, time, kept_, like_ == Like::libgpiod_2);
}

std::vector<GpioChipInfo> FakeGpio::chips() {
  const std::lock_guard lock(*mutex_);
  std::vector<GpioChipInfo> all;
  for (const auto& one : chips_) {
    if (!one->is_there) continue;
    GpioChipInfo& info = all.emplace_back();
    info.path = "/dev/" + one->name;
    info.error_number = one->error_number;
    if (one->error_number != 0) continue;
    info.label = one->label;
    for (const Line& line : one->lines) info.lines.push_back({line.name, line.consumer, !line.consumer.empty()});
  }
  return all;
}

std::unique_ptr<GpioRequest> FakeGpio::take(const std::string& path, unsigned number, const std::string& consumer,
                                            int& error_number) {
  const std::lock_guard lock(*mutex_);
  const auto found = std::find_if(chips_.begin(), chips_.end(),
                                  [&](const auto& one) { return one->is_there && "/dev/" + one->name == path; });
  error_number = found == chips_.end()                       ? ENOENT
                 : number >= (*found)->lines.size()          ? EINVAL
                 : !(*found)->lines[number].consumer.empty() ? EBUSY
                                                             : (*found)->error_number;
  if (error_number != 0) return nullptr;
  (*found)->lines[number].consumer = consumer;
  return std::make_unique<Request>(mutex_, *found, number);
}

std::unique_ptr<GpioRequest> FakeGpio::take_input(const std::string& path, unsigned number, const GpioInput& settings,
                                                  bool with_edges, int& error_number) {
  auto made = take(path, number, settings.consumer, error_number);
  if (made == nullptr) return nullptr;
  auto& request = static_cast<Request&>(*made);
  request.has_edges = with_edges;
  request.kind = settings.edges;
  request.is_active_low = settings.active_low;
  return made;
}

std::unique_ptr<GpioRequest> FakeGpio::take_output(const std::string& path, unsigned number, const GpioOutput& settings,
                                                   int& error_number) {
  auto made = take(path, number, settings.consumer, error_number);
  if (made == nullptr) return nullptr;
  static_cast<Request&>(*made).is_active_low = settings.active_low;
  if (!settings.keep) made->set(settings.initial);
  return made;
}

}  // namespace rtdata
