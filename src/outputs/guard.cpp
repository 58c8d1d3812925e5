// The program's side of the guard.
#include "rtdata/outputs/guard.hpp"

#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <new>

#include "loop/runtime/runtime_core.hpp"
#include "outputs/guard_link.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_guard = "cannot start the guard of the outputs";

}  // namespace

OutputGuard::Link::~Link() {
  endings.clear();
  if (socket >= 0) ::close(socket);
  if (process > 0) {
    // The guard ends when the sockets are closed; a hanging device may delay it.
    for (int tries = 0; tries < 200 && ::waitpid(process, nullptr, WNOHANG) == 0; ++tries) {
      const timespec wait{0, 10'000'000};
      ::nanosleep(&wait, nullptr);
    }
  }
  if (beats != nullptr) ::munmap(beats, sizeof(detail::GuardBeat) * detail::most_guarded);
}

OutputGuard::OutputGuard(const Make& make) : link_(std::make_shared<Link>()) {
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0)
    throw SetupError(system_error(errno, cannot_guard, ""));
  link_->socket = ends[0];
  constexpr std::size_t size = sizeof(detail::GuardBeat) * detail::most_guarded;
  void* const memory = ::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) {
    ::close(ends[1]);
    throw SetupError(system_error(ENOMEM, cannot_guard, ""));
  }
  link_->beats = static_cast<detail::GuardBeat*>(memory);
  std::uninitialized_default_construct_n(link_->beats, detail::most_guarded);
  const pid_t process = ::fork();
  if (process == 0) {
    ::close(ends[0]);
    detail::run_guard(ends[1], link_->beats, make);
  }
  const int error_number = errno;
  ::close(ends[1]);
  if (process < 0) throw SetupError(system_error(error_number, cannot_guard, ""));
  link_->process = process;
}

OutputGuard::~OutputGuard() = default;

void OutputGuard::make_all_safe() noexcept { link_->is_ending.store(true, std::memory_order_release); }

int OutputGuard::process() const noexcept { return link_->process; }

std::vector<std::string> OutputGuard::ended_unsafe() const {
  const std::lock_guard lock(link_->mutex);
  return {link_->unsafe.begin(), link_->unsafe.end()};
}

void OutputGuard::Link::note(const std::string& output, bool is_safe) {
  const std::lock_guard lock(mutex);
  if (is_safe)
    unsafe.erase(output);
  else
    unsafe.insert(output);
}

Result<int> OutputGuard::Link::introduce(const std::string& name, double safe, const std::string& what, int priority,
                                         std::uint32_t& slot) {
  constexpr const char* cannot = "cannot hand the output to its guard";
  if (what.size() > detail::most_guarded_text)
    return Error{
        Errc::does_not_fit, cannot, "",
        "the text of its settings and sources has more than " + std::to_string(detail::most_guarded_text) + " bytes",
        "use fewer or shorter settings"};
  const std::lock_guard lock(mutex);
  const auto free = std::find(is_taken.begin(), is_taken.end(), false);
  if (free == is_taken.end())
    return Error{Errc::does_not_fit, cannot, "", "the guard holds 1024 outputs already, and cannot hold more",
                 "use fewer outputs"};
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0) return system_error(errno, cannot, "");
  slot = static_cast<std::uint32_t>(free - is_taken.begin());
  beats[slot].until.store(0);
  detail::GuardIntroduction introduction{slot, safe, {}, priority};
  detail::put_fitting(introduction.name.data(), introduction.name.size() - 1, name);
  iovec parts[2]{{&introduction, sizeof introduction}, {const_cast<char*>(what.data()), what.size()}};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))]{};
  msghdr message{};
  message.msg_iov = parts;
  message.msg_iovlen = 2;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  cmsghdr* const head = CMSG_FIRSTHDR(&message);
  head->cmsg_level = SOL_SOCKET;
  head->cmsg_type = SCM_RIGHTS;
  head->cmsg_len = CMSG_LEN(sizeof(int));
  std::memcpy(CMSG_DATA(head), &ends[1], sizeof(int));
  const ssize_t sent = ::sendmsg(socket, &message, MSG_NOSIGNAL);
  const int error_number = errno;
  ::close(ends[1]);
  if (sent < 0) {
    ::close(ends[0]);
    Error error = system_error(error_number, cannot, "");
    if (error_number == EPIPE || error_number == ECONNRESET)
      error = {Errc::disconnected, cannot, "", "the guard has ended", "start the program again"};
    return error;
  }
  *free = true;
  return ends[0];
}

void OutputGuard::Link::release(std::uint32_t slot) noexcept {
  const std::lock_guard lock(mutex);
  patience[slot].loop.store(nullptr);
  is_taken[slot] = false;
}

OutputGuard::Link::Ending::~Ending() {
  watch.close();
  if (socket >= 0) ::close(socket);
}

void OutputGuard::Link::await_end(Loop& loop, const std::string& output, int its_socket) {
  const std::lock_guard lock(mutex);
  const auto ending = endings.emplace(endings.end());
  ending->output = output;
  ending->socket = its_socket;
  const auto receive = [this, &loop, ending](const FdEvent&) {
    detail::GuardAnswer answer;
    const ssize_t got = ::recv(ending->socket, &answer, sizeof answer, MSG_DONTWAIT);
    if (got < 0 && (errno == EAGAIN || errno == EINTR)) return;
    const bool is_reported = got == sizeof answer;
    if (is_reported && answer.kind != detail::GuardAnswer::ended) return;
    const bool is_safe = is_reported && answer.code == 0;
    loop.runtime().core().log(is_safe ? LogLevel::warning : LogLevel::error, ending->output,
                              is_reported ? detail::text_of_end(answer.result())
                                          : "its guard has ended, and no other process tries to set it safe");
    if (is_safe) note(ending->output, true);
    std::list<Ending> over;  // is destroyed without the lock
    const std::lock_guard again(mutex);
    over.splice(over.end(), endings, ending);
  };
  try {
    ending->watch = FdWatch(loop, its_socket, FdWatch::readable, output, receive);
  } catch (...) {  // the loop ends, too: the guard sees that the socket is closed
    endings.erase(ending);
    throw;
  }
}

void OutputGuard::Link::beat_for(const Loop& loop) noexcept {
  if (is_ending.load(std::memory_order_acquire)) return;  // the outputs must become safe, by any process
  for (std::size_t slot = 0; slot < patience.size(); ++slot) {
    if (patience[slot].loop.load(std::memory_order_relaxed) != &loop) continue;
    const Duration now = std::chrono::steady_clock::now().time_since_epoch();
    beats[slot].until.store(now.count() + patience[slot].time.load(std::memory_order_relaxed),
                            std::memory_order_release);
  }
}

}  // namespace rtdata
