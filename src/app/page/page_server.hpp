// The server of the live page (docs/page.md): its files, one stream of lines for all open pages, answers to requests.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/config/page.hpp"
#include "rtdata/detail/io/descriptor.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"

namespace rtdata::app {

/// The data that a page shows, of a run or of a recording. Thread: the server's. No function waits; answers come within
/// the call or later, once, as a text of JSON.
class PageSource {
 public:
  using Told = std::function<void(std::string text)>;
  virtual ~PageSource() = default;
  /// A page is open: lines are needed.
  virtual void begin() = 0;
  /// No page is open any more.
  virtual void end() = 0;
  /// Calls `take` with each new line, without its line end.
  virtual void lines(const std::function<void(std::string_view line)>& take) = 0;
  /// An object of data that seldom changes: names, parts, commands.
  virtual std::string about() = 0;
  virtual void status(Told told) = 0;
  /// `request`: an object, from a browser.
  virtual void history(std::string request, Told told) = 0;
  /// A command that the page may give. `by`: who gives it, for the record.
  virtual void command(std::vector<std::string> words, std::string by, Told told) = 0;
};

/// 128 random bits, as text.
std::string make_page_token();

/// A listening socket, and its address. Move-only. Errors of `open`: the system's, such as that the port is taken.
class PageListener {
 public:
  enum class TakenPort { refuse, next };  ///< next: one of the 20 following ports
  static Result<PageListener> open(PageAddress address, TakenPort taken);
  const PageAddress& address() const noexcept { return address_; }
  /// The caller owns it from now on.
  int release() noexcept { return fd_.release(); }

 private:
  PageListener(int fd, PageAddress address) : fd_(fd), address_(std::move(address)) {}
  detail::Descriptor fd_;
  PageAddress address_;
};

/// Serves one page to many browsers. Everybody gets the files; data and commands need the token. All share
/// one stream, whose last 4 MiB are kept: a page that reads too slowly gets the number of lines that it missed.
///
/// Bounded: 256 connections, of which 128 may be streams; 16 KiB per connection; 15 s for a request to come, and 60 s
/// for its answer to be read. When there are many, those that have been silent for longest are closed for new ones.
///
/// Owner: the holder. Thread: the loop's.
class PageServer {
 public:
  static constexpr std::size_t most_connections = 256, most_streams = 128;
  static constexpr std::size_t longest_body = 4096;

  struct Config {
    std::string token;
    std::vector<std::string> commands = {}, names = {};  ///< as of PageSettings
    std::string certificate = {}, key = {};              ///< PEM; empty: not encrypted
  };
  /// Throws SetupError.
  PageServer(Loop& loop, PageListener listener, Config config, PageSource& source);
  PageServer(const PageServer&) = delete;
  PageServer& operator=(const PageServer&) = delete;
  /// Tells open pages that it has ended, for at most 300 ms.
  ~PageServer();

  /// From now on the page may give these commands.
  void set_commands(std::vector<std::string> commands);
  /// The result of `about` has changed.
  void tell_about();

 private:
  struct Library;  // what it calls
  struct Peer;
  struct Request;
  struct Stream;
  struct Chunk {
    std::uint64_t lines_before = 0;
    MonotonicTime at{};
    std::string text;
  };

  void start_daemon(PageListener listener);
  void run();
  void turn();
  void add_line(std::string_view line);
  void close_chunk();
  void ask_status();
  void resume_streams();
  void sweep();
  void peer_came(Peer& peer);
  /// The HTTP status of a refused request; 0: it is not refused.
  unsigned refusal(void* connection, std::string_view url, std::string_view method) const;
  bool is_own_name(std::string_view host) const;
  int handle(void* connection, const char* url, const char* method, const char* upload, std::size_t* size,
             void** request);
  int answer_file(void* connection, std::string_view path);
  int begin_stream(void* connection, Request& request);
  int begin_question(void* connection, Request& request);
  void answered(std::uint64_t number, unsigned status, std::string text);
  int reply(void* connection, unsigned status, std::string_view type, std::string_view text);
  std::ptrdiff_t give(Stream& stream, char* to, std::size_t most);

  Loop& loop_;
  Config config_;
  PageSource& source_;
  PageAddress address_;
  std::string host_name_;
  std::string epoch_;  // identifies this server in the ids of the stream
  void* daemon_ = nullptr;
  FdWatch watch_;
  Ticker ticker_;
  std::list<Peer> peers_;
  std::map<std::uint64_t, Request*> requests_;  // requests that wait for an answer
  std::uint64_t last_request_ = 0;
  std::list<Stream> streams_;
  bool has_begun_ = false;  // the source
  bool is_ending_ = false;

  std::deque<Chunk> chunks_;
  std::uint64_t first_chunk_ = 1;  // number of the first of these
  std::size_t chunk_bytes_ = 0;
  std::uint64_t lines_ = 0;
  std::string pending_;
  std::map<std::string, std::string, std::less<>> units_;  // the lines with the units, by topic
  std::string status_;                                     // the last line
  bool is_status_asked_ = false;
  MonotonicTime status_at_{};
  std::shared_ptr<bool> is_alive_ = std::make_shared<bool>(true);  // for answers that come late
};

}  // namespace rtdata::app
