// A connection to a PostgreSQL server with libpq; no call waits longer than the timeout. Not thread-safe: one user at a
// time.
//
// Failures in this folder throw SetupError, directly or by Result::or_throw. Each function called from outside catches
// it and returns the error.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "postgresql/libpq.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::postgresql {

struct Address {
  std::string url = {}, host = {}, database = {}, user = {}, password = {}, schema = {};
  int port = 0;
  Duration timeout = std::chrono::seconds{30};
  /// The name of its sessions on the server. A session left from an earlier connection of this name is ended, so the
  /// name must be unique.
  std::string name = {};
};

/// The password that is in the URL itself; empty: none. Throws not_found (there is no libpq), bad_argument (it does not
/// understand the URL).
std::string password_in(const std::string& url);

struct Clear {
  void operator()(PGresult* result) const noexcept { PQclear(result); }
  void operator()(PGconn* connection) const noexcept { PQfinish(connection); }
};
/// Rows of an answer, as texts or in binary.
class Reply {
 public:
  explicit Reply(PGresult* result) : result_(result) {}
  PGresult* raw() const noexcept { return result_.get(); }
  int rows() const noexcept { return PQntuples(result_.get()); }
  bool is_null(int row, int column) const noexcept { return PQgetisnull(result_.get(), row, column) != 0; }
  std::string_view text(int row, int column) const noexcept {
    return {PQgetvalue(result_.get(), row, column), static_cast<std::size_t>(PQgetlength(result_.get(), row, column))};
  }
  std::int64_t integer(int row, int column) const noexcept;

 private:
  std::unique_ptr<PGresult, Clear> result_;
};

class Connection {
 public:
  Connection() = default;
  /// Throws not_permitted, not_found (the database), disconnected, timed_out, bad_argument (not UTF8).
  explicit Connection(const Address& address);

  explicit operator bool() const noexcept { return connection_ != nullptr; }
  /// One or more statements; returns the last answer.
  Reply run(const std::string& sql) { return query(sql, {}); }
  /// One statement with parameters, all of them texts.
  Reply query(const std::string& sql, std::span<const std::string> parameters);
  /// Statements among which are `COPY ... FROM STDIN`: each gets the next of `data`. In one round trip.
  void copy(const std::string& sql, std::span<const std::string_view> data);
  /// One statement, whose values come in binary: calls `row` with one answer for each row. If that throws, the others
  /// stay unread, and the connection cannot be used any more.
  void each(const std::string& sql, const std::function<void(const Reply&)>& row);
  void set_timeout(Duration timeout) noexcept { timeout_ = timeout; }
  /// Ends a failed transaction, if there is one.
  void roll_back() noexcept;
  void close() noexcept { connection_.reset(); }

 private:
  using Clock = std::chrono::steady_clock;
  /// Reads all answers to what was sent (0: it was not) and calls `take` with each, up to the first that is an error:
  /// that is thrown after the last.
  void answers(int sent, const char* what, const std::function<void(Reply)>& take);
  /// Sends what is waiting and returns the next result; null after the last.
  PGresult* next();
  /// Returns which of them.
  short wait(short events, Clock::time_point until);
  void put(std::string_view data);
  Error error_in(const PGresult* result, const char* what);
  [[noreturn]] void lost();
  [[noreturn]] void end(Errc code, std::string why, const char* advice);

  std::unique_ptr<PGconn, Clear> connection_;
  const char* doing_ = "cannot connect";
  std::string where_;
  std::vector<std::string> secrets_;
  Duration timeout_{};
};

/// "name" with quotes doubled, for use in SQL; and 'text'.
std::string quoted_name(std::string_view name);
std::string literal(std::string_view text);

}  // namespace rtdata::postgresql
