// Sends parcels as HTTP requests: several in flight; sends halves if the peer refuses a part.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "net/host_lookup.hpp"
#include "net/http_request.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sinks/http.hpp"
#include "rtdata/sinks/sender.hpp"
#include "sinks/http/curl_multi.hpp"

namespace rtdata::detail {

/// The key of a request, equal for each attempt.
using HttpKey = std::array<std::uint64_t, 2>;
/// A key of these rows of the parcel, made of their runs, origins and sequences.
HttpKey key_of(const Parcel& parcel, std::size_t first, std::size_t last);

std::vector<SettingMistake> mistakes_of(const HttpConfig& config);

class HttpSender final : public Sender {
 public:
  /// Throws SetupError.
  HttpSender(HttpConfig config, std::unique_ptr<Codec> codec);
  ~HttpSender() override;

  SendingConfig sending() const override;
  void begin(Loop& loop) override;
  void send(const Parcel& parcel, Answer answer) override;
  void cancel() override;
  void end() override;
  Result<void> encode(const Record& record, std::vector<std::byte>& out) override;

 private:
  class GzipJob;
  struct Range {
    std::size_t first = 0;
    std::size_t last = 0;  // without it
  };
  using Refusals = std::vector<std::pair<std::size_t, Error>>;
  /// The rest of a parcel.
  struct Rest {
    std::vector<Range> ranges;  // the last is sent next
    Refusals refused;           // of what was sent
    int cut_answers = 0;        // to the one that is sent, one after the other
  };
  enum class State { idle, compressing, waiting, transferring };  // waiting: for the name
  /// A request, which is used again and again.
  struct Request;

  Request& free_request();
  void make_easy(Request& request);
  void start(Request& request);
  void start_transfer(Request& request);
  void transfer(Request& request);
  void look_up();
  void looked_up(const Result<std::vector<HostLookup::Address>>& found);
  void transferred(CURL* easy, CURLcode result);
  bool is_cut_answer(const Request& request, CURLcode result, long status) const;
  void count_cut_answer(const Request& request);
  void take(Request& request, HttpJudgement judgement);
  void complete(Request& request);
  void give_up(Request& request, HttpJudgement judgement);
  /// Takes it from libcurl, the lane and the name, and remembers what is left.
  void stop(Request& request);
  void watch_deadlines();
  void deadline();
  static bool has_connected(const Request& request);
  Error where_it_stands(const Request& request) const;
  Error shown(Error error) const;

  const HttpConfig config_;
  const std::unique_ptr<Codec> codec_;  // the lane's
  const HttpUrl url_;
  std::optional<HttpUrl> proxy_;
  bool is_array_ = false;
  std::vector<std::string> secrets_;
  curl_slist* headers_ = nullptr;

  Loop* loop_ = nullptr;
  std::unique_ptr<CurlMulti> multi_;
  std::vector<std::unique_ptr<Request>> requests_;
  std::vector<std::pair<HttpKey, Rest>> rests_;  // of parcels that come again
  Timer deadline_;
  std::unique_ptr<Lane> gzip_lane_;
  std::unique_ptr<HostLookup> lookup_;
  std::string addresses_;  // of the server, or of the proxy, for CURLOPT_RESOLVE; empty: not known
  std::uint64_t addresses_number_ = 0;
  MonotonicTime looked_up_at_{};
  std::uint64_t cut_ = 0;  // events that count as delivered, though the answer was cut off
  std::shared_ptr<bool> is_alive_ = std::make_shared<bool>(true);
};

}  // namespace rtdata::detail
