#include "app/page/page_server.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "app/page/libmicrohttpd.hpp"
#include "app/page/page_files.hpp"
#include "net/ip_address.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr Duration pace = std::chrono::milliseconds{200};  // of what is sent
constexpr Duration status_pace = std::chrono::seconds{1};
constexpr Duration idle_limit = std::chrono::seconds{15};  // for a request to come
constexpr Duration busy_limit = std::chrono::seconds{60};  // for reading the answer, or the next part of a stream
constexpr Duration seam = std::chrono::seconds{5};         // how much of the past a page gets at its beginning
constexpr Duration end_patience = std::chrono::milliseconds{300};
constexpr std::size_t most_kept = std::size_t{4} << 20;
constexpr std::size_t most_waiting = 64;  // requests
constexpr std::size_t crowded = PageServer::most_connections * 3 / 4;
constexpr std::uint16_t next_ports = 20;

constexpr const char* json_type = "application/json";

// dygraphs sets its styles by objects, which this allows; all other styles are in the page's file.
constexpr std::pair<const char*, const char*> headers[] = {
    {"Content-Security-Policy", "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"},
    {"X-Content-Type-Options", "nosniff"},
    {"Referrer-Policy", "no-referrer"},
    {"Cross-Origin-Resource-Policy", "same-origin"},
    {"Cache-Control", "no-store"},
};

std::string error_text(std::string_view why) {
  return Json{{"error", why}}.dump(-1, ' ', false, Json::error_handler_t::replace);
}

/// Takes the same time, wherever the first difference is.
bool is_equal(std::string_view given, std::string_view wanted) noexcept {
  unsigned char differs = given.size() == wanted.size() ? 0 : 1;
  for (std::size_t i = 0; i < wanted.size(); ++i)
    differs |= static_cast<unsigned char>((i < given.size() ? given[i] : 0) ^ wanted[i]);
  return differs == 0;
}

std::string_view header_of(MHD_Connection* connection, const char* name) {
  const char* const value = MHD_lookup_connection_value(connection, MHD_HEADER_KIND, name);
  return value == nullptr ? std::string_view() : std::string_view(value);
}

/// "127.0.0.1"
std::string peer_text(MHD_Connection* connection) {
  const auto* const info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (info == nullptr || info->client_addr == nullptr) return "somebody";
  if (info->client_addr->sa_family == AF_INET)
    ::inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(info->client_addr)->sin_addr, text.data(), text.size());
  else
    ::inet_ntop(AF_INET6, &reinterpret_cast<const sockaddr_in6*>(info->client_addr)->sin6_addr, text.data(),
                text.size());
  return text.data();
}

std::string random_text(std::size_t bytes) {
  std::vector<unsigned char> random(bytes);
  if (::getrandom(random.data(), random.size(), 0) != static_cast<ssize_t>(bytes))
    throw SetupError(system_error(errno, "no token for the page", "random numbers of the kernel"));
  std::string text;
  for (const unsigned char byte : random) {
    text += "0123456789abcdef"[byte >> 4];
    text += "0123456789abcdef"[byte & 15];
  }
  return text;
}

}  // namespace

std::string make_page_token() { return random_text(16); }

// ---- the socket

Result<PageListener> PageListener::open(PageAddress address, TakenPort taken) {
  const std::uint16_t last = static_cast<std::uint16_t>(
      std::min(65535, address.port + (taken == TakenPort::next && address.port != 0 ? next_ports : 0)));
  for (std::uint16_t port = address.port;; ++port) {
    const detail::IpAddress to = detail::ip_address(address.host, port).value();
    PageListener made(::socket(to.storage.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0), address);
    const int on = 1;
    if (made.fd_.fd() >= 0 && ::setsockopt(made.fd_.fd(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) == 0 &&
        ::bind(made.fd_.fd(), to.get(), to.size) == 0 && ::listen(made.fd_.fd(), 128) == 0) {
      detail::IpAddress bound{.size = sizeof bound.storage};
      ::getsockname(made.fd_.fd(), reinterpret_cast<sockaddr*>(&bound.storage), &bound.size);
      made.address_.port = ntohs(bound.v4().sin_port);  // at the same place in both
      return made;
    }
    const int error = errno;
    if (error == EADDRINUSE && port < last) continue;
    PageAddress at = address;
    at.port = port;
    Error why = system_error(error, "cannot serve the page", at.text());
    if (error == EADDRINUSE)
      why.advice = "give the page another port, or end the program that uses this one: `ss -tlnp` shows it";
    return why;
  }
}

// ---- the server

struct PageServer::Peer {
  MHD_Connection* connection;
  int fd;
  MonotonicTime since{};  // it was made, or its last request was answered, or this one came
  bool is_busy = false;   // a request is being answered
  bool is_stream = false;
  bool is_shut = false;
  std::list<Peer>::iterator self = {};

  void shut() {
    if (!std::exchange(is_shut, true)) ::shutdown(fd, SHUT_RDWR);
  }
};

struct PageServer::Request {
  std::uint64_t number = 0;
  std::string url;
  std::string body;
  MHD_Connection* connection = nullptr;
  bool is_too_long = false;
  bool is_asked = false;
  bool is_answered = false;
  unsigned status = MHD_HTTP_OK;
  std::string answer;
};

struct PageServer::Stream {
  PageServer* to;
  MHD_Connection* connection;
  Peer* peer;
  std::string head;  // is sent before the chunks
  std::size_t given = 0;
  std::uint64_t next = 0;  // chunk
  std::size_t offset = 0;  // in it
  bool is_suspended = false;
  std::list<Stream>::iterator self = {};
};

/// The functions that libmicrohttpd calls. All are called within `run`.
struct PageServer::Library {
  static MHD_Result handle(void* to, MHD_Connection* connection, const char* url, const char* method, const char*,
                           const char* upload, std::size_t* size, void** request) {
    return static_cast<PageServer*>(to)->handle(connection, url, method, upload, size, request) != 0 ? MHD_YES : MHD_NO;
  }
  static void completed(void* to, MHD_Connection* connection, void** request, MHD_RequestTerminationCode) {
    auto& server = *static_cast<PageServer*>(to);
    auto* const done = static_cast<Request*>(std::exchange(*request, nullptr));
    if (done != nullptr) server.requests_.erase(done->number);
    delete done;
    if (Peer* const peer = peer_of(connection)) {
      peer->is_busy = false;
      peer->since = server.loop_.now();
    }
  }
  static void notify(void* to, MHD_Connection* connection, void** context, MHD_ConnectionNotificationCode code) {
    auto& server = *static_cast<PageServer*>(to);
    if (code == MHD_CONNECTION_NOTIFY_STARTED) {
      const auto* const info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
      Peer& peer = server.peers_.emplace_back(Peer{connection, info->connect_fd, server.loop_.now()});
      peer.self = std::prev(server.peers_.end());
      *context = &peer;
      server.peer_came(peer);
    } else if (*context != nullptr) {
      server.peers_.erase(static_cast<Peer*>(std::exchange(*context, nullptr))->self);
    }
  }
  static Peer* peer_of(MHD_Connection* connection) {
    const auto* const info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    return info == nullptr ? nullptr : static_cast<Peer*>(info->socket_context);
  }
  static ssize_t give(void* stream, std::uint64_t, char* to, std::size_t most) {
    auto& of = *static_cast<Stream*>(stream);
    return of.to->give(of, to, most);
  }
  static void gone(void* stream) {
    auto& of = *static_cast<Stream*>(stream);
    of.to->streams_.erase(of.self);
  }
  static MHD_Daemon* daemon(const PageServer& of) { return static_cast<MHD_Daemon*>(of.daemon_); }
  static MHD_Connection* connection(void* of) { return static_cast<MHD_Connection*>(of); }
};

PageServer::PageServer(Loop& loop, PageListener listener, Config config, PageSource& source)
    : loop_(loop), config_(std::move(config)), source_(source), address_(listener.address()), epoch_(random_text(4)) {
  std::array<char, 256> name{};
  if (::gethostname(name.data(), name.size() - 1) == 0) host_name_ = name.data();
  detail::libmicrohttpd.load().or_throw();
  start_daemon(std::move(listener));
  const auto* const info = MHD_get_daemon_info(Library::daemon(*this), MHD_DAEMON_INFO_EPOLL_FD);
  watch_ = FdWatch(loop_, info->epoll_fd, FdWatch::readable, "page", [this](const FdEvent&) { run(); });
  ticker_ = Ticker(loop_, Ticker::Config{.period = pace, .name = "page"}, [this](const Tick&) { turn(); });
  ticker_.stop();
}

void PageServer::start_daemon(PageListener listener) {
  const bool is_encrypted = !config_.certificate.empty();
  if (is_encrypted && MHD_is_feature_supported(MHD_FEATURE_TLS) != MHD_YES)
    throw SetupError({Errc::not_found, "cannot serve the page", address_.text(),
                      "the libmicrohttpd of this machine cannot encrypt", "put a server that encrypts before it"});
  std::vector<MHD_OptionItem> options;
  const auto add = [&](MHD_OPTION option, std::intptr_t value, void* pointer = nullptr) {
    options.push_back({option, value, pointer});
  };
  const int fd = listener.release();  // the daemon closes it, unless it does not start
  add(MHD_OPTION_LISTEN_SOCKET, fd);
  add(MHD_OPTION_CONNECTION_LIMIT, most_connections);
  add(MHD_OPTION_CONNECTION_MEMORY_LIMIT, 16 << 10);
  add(MHD_OPTION_CONNECTION_TIMEOUT, std::chrono::duration_cast<std::chrono::seconds>(idle_limit).count());
  add(MHD_OPTION_SIGPIPE_HANDLED_BY_APP, 1);
  using Pointer = void*;
  const auto as_value = [](auto* function) { return reinterpret_cast<std::intptr_t>(function); };
  add(MHD_OPTION_NOTIFY_CONNECTION, as_value(&Library::notify), this);
  add(MHD_OPTION_NOTIFY_COMPLETED, as_value(&Library::completed), this);
  // The library reports browsers that leave.
  add(MHD_OPTION_EXTERNAL_LOGGER, as_value(+[](void*, const char*, va_list) {}), nullptr);
  if (is_encrypted) {
    add(MHD_OPTION_HTTPS_MEM_CERT, 0, Pointer{config_.certificate.data()});
    add(MHD_OPTION_HTTPS_MEM_KEY, 0, Pointer{config_.key.data()});
  }
  add(MHD_OPTION_END, 0);
  const unsigned flags = MHD_USE_EPOLL | MHD_ALLOW_SUSPEND_RESUME | (is_encrypted ? unsigned{MHD_USE_TLS} : 0U) |
                         (address_.is_ipv6() ? unsigned{MHD_USE_IPv6} : 0U) | MHD_USE_ERROR_LOG;
  daemon_ = MHD_start_daemon(flags, address_.port, nullptr, nullptr, &Library::handle, this, MHD_OPTION_ARRAY,
                             options.data(), MHD_OPTION_END);
  if (daemon_ != nullptr) return;
  ::close(fd);
  throw SetupError({Errc::io_failed, "cannot serve the page", address_.text(), "libmicrohttpd does not start",
                    is_encrypted ? "see whether the files of `tls` are a certificate and its key as PEM" : ""});
}

PageServer::~PageServer() {
  *is_alive_ = false;
  is_ending_ = true;
  add_line(R"({"ended":"the run has ended"})");
  close_chunk();
  for (auto& [number, request] : requests_) {
    request->is_answered = true;
    request->status = MHD_HTTP_SERVICE_UNAVAILABLE;
    request->answer = error_text("it has ended");
    MHD_resume_connection(request->connection);
  }
  requests_.clear();
  const int epoll = MHD_get_daemon_info(Library::daemon(*this), MHD_DAEMON_INFO_EPOLL_FD)->epoll_fd;
  const auto until = std::chrono::steady_clock::now() + end_patience;
  do {
    resume_streams();
    for (int i = 0; i < 8; ++i) MHD_run(Library::daemon(*this));
    pollfd ready{epoll, POLLIN, 0};
    if (!streams_.empty()) ::poll(&ready, 1, 10);
  } while (!streams_.empty() && std::chrono::steady_clock::now() < until);
  watch_.close();
  ticker_.close();
  for (Stream& stream : streams_)
    if (std::exchange(stream.is_suspended, false)) MHD_resume_connection(stream.connection);
  MHD_stop_daemon(Library::daemon(*this));
  if (has_begun_) source_.end();
}

void PageServer::set_commands(std::vector<std::string> commands) { config_.commands = std::move(commands); }

void PageServer::tell_about() {
  if (streams_.empty()) return;
  add_line("{\"about\":" + source_.about() + "}");
  units_.clear();  // the units of the present topics are sent again
}

void PageServer::run() {
  constexpr int most_rounds = 32;
  for (int i = 0; i < most_rounds; ++i) {
    MHD_run(Library::daemon(*this));
    MHD_UNSIGNED_LONG_LONG wait = 1;
    if (MHD_get_timeout(Library::daemon(*this), &wait) != MHD_YES || wait > 0) break;
    if (i + 1 < most_rounds) continue;
    loop_.post([this, is_alive = is_alive_] {
      if (*is_alive) run();
    });
  }
  if (!peers_.empty() && !ticker_.is_running()) ticker_.start();
}

void PageServer::turn() {
  if (!streams_.empty()) {
    if (!std::exchange(has_begun_, true)) source_.begin();
    source_.lines([this](std::string_view line) { add_line(line); });
    ask_status();
    close_chunk();
    resume_streams();
  } else if (std::exchange(has_begun_, false)) {
    source_.end();
    units_.clear();
    status_.clear();
  }
  sweep();
  run();
  if (peers_.empty() && !has_begun_) ticker_.stop();
}

void PageServer::add_line(std::string_view line) {
  ++lines_;
  pending_.append(line).append("\n");
  constexpr std::string_view of_units = "{\"units\":", of = "},\"of\":\"";
  if (!line.starts_with(of_units)) return;
  const std::size_t topic = line.rfind(of);
  if (topic != std::string_view::npos) units_[std::string(line.substr(topic + of.size()))] = line;
}

void PageServer::close_chunk() {
  if (pending_.empty()) return;
  pending_ += "{\"id\":\"" + epoch_ + "-" + std::to_string(first_chunk_ + chunks_.size()) + "\"}\n";
  chunk_bytes_ += pending_.size();
  chunks_.push_back({lines_, loop_.now(), std::exchange(pending_, {})});
  while (chunk_bytes_ > most_kept && chunks_.size() > 1) {
    chunk_bytes_ -= chunks_.front().text.size();
    chunks_.pop_front();
    ++first_chunk_;
  }
}

void PageServer::ask_status() {
  if (is_status_asked_ || loop_.now() - status_at_ < status_pace) return;
  is_status_asked_ = true;
  status_at_ = loop_.now();
  source_.status([this, is_alive = is_alive_](std::string text) {
    if (!*is_alive) return;
    is_status_asked_ = false;
    status_ = "{\"status\":" + std::move(text) + "}";
    add_line(status_);
  });
}

void PageServer::resume_streams() {
  for (Stream& stream : streams_) {
    if (!stream.is_suspended || (stream.next >= first_chunk_ + chunks_.size() && !is_ending_)) continue;
    stream.is_suspended = false;
    MHD_resume_connection(stream.connection);
  }
}

void PageServer::sweep() {
  const MonotonicTime now = loop_.now();
  for (Peer& peer : peers_) {
    const bool is_slow = now - peer.since > (peer.is_busy ? busy_limit : idle_limit);
    if (is_slow) peer.shut();
  }
}

/// Makes room for a connection: closes the one that has been silent for longest, of those without a request.
void PageServer::peer_came(Peer& peer) {
  const int keep = 1, idle_s = 15, probes = 3;  // a peer that is gone without a word
  ::setsockopt(peer.fd, SOL_SOCKET, SO_KEEPALIVE, &keep, sizeof keep);
  ::setsockopt(peer.fd, IPPROTO_TCP, TCP_KEEPIDLE, &idle_s, sizeof idle_s);
  ::setsockopt(peer.fd, IPPROTO_TCP, TCP_KEEPINTVL, &idle_s, sizeof idle_s);
  ::setsockopt(peer.fd, IPPROTO_TCP, TCP_KEEPCNT, &probes, sizeof probes);
  if (!ticker_.is_running() && !is_ending_) ticker_.start();
  if (peers_.size() <= crowded) return;
  Peer* silent = nullptr;
  for (Peer& one : peers_)
    if (!one.is_busy && !one.is_shut && &one != &peer && (silent == nullptr || one.since < silent->since))
      silent = &one;
  if (silent != nullptr) silent->shut();
}

// ---- requests

bool PageServer::is_own_name(std::string_view host) const {
  const std::size_t colon = host.rfind(':');
  std::string name(host);
  if (colon != std::string_view::npos && host.find(']', colon) == std::string_view::npos) name.resize(colon);
  std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return std::tolower(c); });
  // A foreign name that leads here is refused, because a foreign page could then use this one. A numeric address cannot
  // be redirected.
  std::array<unsigned char, 16> bytes{};
  if (::inet_pton(AF_INET, name.c_str(), bytes.data()) == 1) return true;
  if (name.size() > 2 && name.front() == '[' && name.back() == ']' &&
      ::inet_pton(AF_INET6, name.substr(1, name.size() - 2).c_str(), bytes.data()) == 1)
    return true;
  if (name == "localhost" || (!host_name_.empty() && (name == host_name_ || name == host_name_ + ".local")))
    return true;
  return std::find(config_.names.begin(), config_.names.end(), name) != config_.names.end();
}

unsigned PageServer::refusal(void* of, std::string_view url, std::string_view method) const {
  MHD_Connection* const connection = Library::connection(of);
  const std::string_view host = header_of(connection, "Host"), origin = header_of(connection, "Origin");
  if (!is_own_name(host)) return MHD_HTTP_MISDIRECTED_REQUEST;
  if (!origin.empty() && origin != "http://" + std::string(host) && origin != "https://" + std::string(host))
    return MHD_HTTP_FORBIDDEN;
  const auto files = page_files();
  const bool is_file = std::any_of(files.begin(), files.end(), [&](const PageFile& one) { return one.path == url; });
  const bool is_command = url == "/command";
  const bool is_question = url == "/status" || url == "/history" || url == "/events";
  if (!is_file && !is_command && !is_question) return MHD_HTTP_NOT_FOUND;
  if (method != (is_command ? "POST" : "GET")) return MHD_HTTP_METHOD_NOT_ALLOWED;
  if (is_file) return 0;
  constexpr std::string_view scheme = "Bearer ";
  const std::string_view given = header_of(connection, "Authorization");
  if (!given.starts_with(scheme) || !is_equal(given.substr(scheme.size()), config_.token)) return MHD_HTTP_UNAUTHORIZED;
  if (!is_command) return 0;
  const std::string_view type = header_of(connection, "Content-Type");
  if (type != json_type && !type.starts_with("application/json;")) return MHD_HTTP_UNSUPPORTED_MEDIA_TYPE;
  const std::string_view length = header_of(connection, "Content-Length");
  if (length.size() > 4 || (!length.empty() && std::atoi(std::string(length).c_str()) > static_cast<int>(longest_body)))
    return MHD_HTTP_CONTENT_TOO_LARGE;
  return 0;
}

int PageServer::handle(void* of, const char* url, const char* method, const char* upload, std::size_t* size,
                       void** state) {
  MHD_Connection* const connection = Library::connection(of);
  if (*state == nullptr) {  // the headers are there
    if (Peer* const peer = Library::peer_of(connection)) {
      peer->is_busy = true;
      peer->since = loop_.now();
    }
    auto* const made = new Request;
    made->number = ++last_request_;
    made->url = url;
    *state = made;
    const unsigned refused = refusal(of, url, method);
    if (refused != 0) {
      constexpr std::pair<unsigned, const char*> words[] = {
          {MHD_HTTP_MISDIRECTED_REQUEST,
           "the name in the address is not one of this machine's: add it to `names` of the page"},
          {MHD_HTTP_FORBIDDEN, "this request comes from a page of another server"},
          {MHD_HTTP_NOT_FOUND, "there is no such page"},
          {MHD_HTTP_METHOD_NOT_ALLOWED, "use POST for commands, and GET for all else"},
          {MHD_HTTP_UNAUTHORIZED, "the token is wrong, or there is none: use the address that the program printed"},
          {MHD_HTTP_UNSUPPORTED_MEDIA_TYPE, "a command is JSON"},
          {MHD_HTTP_CONTENT_TOO_LARGE, "a command has 4096 bytes at most"}};
      for (const auto& [status, text] : words)
        if (status == refused) return reply(of, refused, json_type, error_text(text));
    }
    return 1;
  }
  Request& request = *static_cast<Request*>(*state);
  if (*size > 0) {
    request.is_too_long = request.is_too_long || request.body.size() + *size > longest_body;
    if (request.is_too_long) return 0;  // it did not say so before
    request.body.append(upload, *size);
    *size = 0;
    return 1;
  }
  if (request.is_answered) return reply(of, request.status, json_type, request.answer);
  if (request.is_asked) return 1;
  request.connection = connection;
  if (request.url == "/events") return begin_stream(of, request);
  if (request.url == "/command" || request.url == "/history" || request.url == "/status")
    return begin_question(of, request);
  return answer_file(of, request.url);
}

int PageServer::answer_file(void* of, std::string_view path) {
  for (const PageFile& file : page_files())
    if (file.path == path) return reply(of, MHD_HTTP_OK, file.type, file.text);
  return 0;
}

int PageServer::reply(void* of, unsigned status, std::string_view type, std::string_view text) {
  MHD_Response* const response = MHD_create_response_from_buffer(
      text.size(), const_cast<char*>(text.data()), type == json_type ? MHD_RESPMEM_MUST_COPY : MHD_RESPMEM_PERSISTENT);
  if (response == nullptr) return 0;
  for (const auto& [name, value] : headers) MHD_add_response_header(response, name, value);
  MHD_add_response_header(response, "Content-Type", std::string(type).c_str());
  if (status == MHD_HTTP_UNAUTHORIZED) MHD_add_response_header(response, "WWW-Authenticate", "Bearer");
  const auto queued = MHD_queue_response(Library::connection(of), status, response);
  MHD_destroy_response(response);
  return queued == MHD_YES ? 1 : 0;
}

int PageServer::begin_stream(void* of, Request&) {
  MHD_Connection* const connection = Library::connection(of);
  if (streams_.size() >= most_streams)
    return reply(of, MHD_HTTP_SERVICE_UNAVAILABLE, json_type,
                 error_text(std::to_string(most_streams) + " pages are open, and no more are allowed"));
  Stream& stream = streams_.emplace_back(Stream{this, connection, Library::peer_of(connection), {}});
  stream.self = std::prev(streams_.end());
  stream.next = first_chunk_;
  const char* const last = MHD_lookup_connection_value(connection, MHD_GET_ARGUMENT_KIND, "after");
  const std::string_view after = last == nullptr ? "" : last;
  const std::uint64_t end = first_chunk_ + chunks_.size();
  std::uint64_t known = 0;
  if (after.starts_with(epoch_ + "-")) known = std::strtoull(after.data() + epoch_.size() + 1, nullptr, 10);
  const bool goes_on = known + 1 >= first_chunk_ && known < end && known != 0;
  if (goes_on) {
    stream.next = known + 1;
  } else {
    while (stream.next < end && loop_.now() - chunks_[stream.next - first_chunk_].at > seam) ++stream.next;
  }
  stream.head = Json{{"page", {{"stream", epoch_}, {"goes_on", goes_on}, {"commands", config_.commands}}}}.dump() +
                "\n";
  stream.head += "{\"about\":" + source_.about() + "}\n";
  for (const auto& [topic, line] : units_) stream.head += line + "\n";
  if (!status_.empty()) stream.head += status_ + "\n";
  MHD_Response* const response = MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, 16 << 10, &Library::give, &stream,
                                                                   &Library::gone);
  if (response == nullptr) {
    streams_.pop_back();
    return 0;
  }
  for (const auto& [name, value] : headers) MHD_add_response_header(response, name, value);
  MHD_add_response_header(response, "Content-Type", "application/x-ndjson");
  MHD_set_connection_option(connection, MHD_CONNECTION_OPTION_TIMEOUT, 0U);
  if (stream.peer != nullptr) stream.peer->is_stream = true;
  if (!ticker_.is_running()) ticker_.start();
  const auto queued = MHD_queue_response(connection, MHD_HTTP_OK, response);
  MHD_destroy_response(response);
  return queued == MHD_YES ? 1 : 0;
}

std::ptrdiff_t PageServer::give(Stream& stream, char* to, std::size_t most) {
  const std::uint64_t end = first_chunk_ + chunks_.size();
  if (stream.given == stream.head.size() && stream.next < first_chunk_) {  // it reads too slowly
    stream.head = "{\"left_out\":" + std::to_string(first_chunk_ - stream.next) + "}\n";
    if (stream.offset > 0) stream.head.insert(0, "\n");  // ends the incomplete line
    stream.given = 0;
    stream.next = first_chunk_;
    stream.offset = 0;
  }
  std::size_t given = 0;
  const auto copy = [&](const std::string& from, std::size_t& at) {
    const std::size_t size = std::min(most - given, from.size() - at);
    std::memcpy(to + given, from.data() + at, size);
    given += size;
    at += size;
  };
  copy(stream.head, stream.given);
  while (given < most && stream.given == stream.head.size() && stream.next < end) {
    const Chunk& chunk = chunks_[stream.next - first_chunk_];
    copy(chunk.text, stream.offset);
    if (stream.offset < chunk.text.size()) break;
    ++stream.next;
    stream.offset = 0;
  }
  if (stream.peer != nullptr) stream.peer->since = loop_.now();
  if (given > 0) return static_cast<std::ptrdiff_t>(given);
  if (is_ending_) return MHD_CONTENT_READER_END_OF_STREAM;
  stream.is_suspended = true;
  MHD_suspend_connection(stream.connection);
  return 0;
}

int PageServer::begin_question(void* of, Request& request) {
  if (requests_.size() >= most_waiting)
    return reply(of, MHD_HTTP_SERVICE_UNAVAILABLE, json_type, error_text("too many requests at a time: ask again"));
  std::vector<std::string> words;
  std::string by;
  const char* const question = MHD_lookup_connection_value(request.connection, MHD_GET_ARGUMENT_KIND, "q");
  if (request.url == "/command") {
    const Json given = Json::parse(request.body, nullptr, false);
    const bool is_command = given.is_object() && given.contains("words") && given["words"].is_array() &&
                            !given["words"].empty() &&
                            std::all_of(given["words"].begin(), given["words"].end(),
                                        [](const Json& word) { return word.is_string() && !word.empty(); });
    if (!is_command)
      return reply(of, MHD_HTTP_BAD_REQUEST, json_type, error_text("a command is {\"words\": [\"note\", \"text\"]}"));
    words = given["words"].get<std::vector<std::string>>();
    if (std::find(config_.commands.begin(), config_.commands.end(), words[0]) == config_.commands.end())
      return reply(of, MHD_HTTP_FORBIDDEN, json_type,
                   error_text("the page may not give the command \"" + words[0] +
                              "\": `commands` of the page lists those that it may"));
    by = "page, " + peer_text(request.connection);
    constexpr std::size_t longest_name = 30;
    const auto who = given.find("who");
    if (who != given.end() && who->is_string() && !who->get_ref<const std::string&>().empty())
      by = who->get<std::string>().substr(0, longest_name) + " (" + by + ")";
    if (std::any_of(by.begin(), by.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; }))
      return reply(of, MHD_HTTP_BAD_REQUEST, json_type, error_text("the name has a control character"));
  }
  request.is_asked = true;
  requests_[request.number] = &request;
  MHD_suspend_connection(request.connection);
  const auto told = [this, number = request.number, is_alive = is_alive_](std::string text) {
    if (*is_alive) answered(number, MHD_HTTP_OK, std::move(text));
  };
  if (request.url == "/command") {
    source_.command(std::move(words), std::move(by), told);
  } else if (request.url == "/history") {
    source_.history(question == nullptr ? "" : question, told);
  } else {
    source_.status(told);
  }
  return 1;
}

void PageServer::answered(std::uint64_t number, unsigned status, std::string text) {
  const auto found = requests_.find(number);
  if (found == requests_.end()) return;
  Request& request = *found->second;
  requests_.erase(found);
  request.is_answered = true;
  request.status = status;
  request.answer = std::move(text);
  MHD_resume_connection(request.connection);
  loop_.post([this, is_alive = is_alive_] {
    if (*is_alive) run();
  });
}

}  // namespace rtdata::app
