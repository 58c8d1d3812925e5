#include "postgresql/connection.hpp"

#include <poll.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <iterator>
#include <optional>
#include <utility>

#include "data/hidden.hpp"
#include "postgresql/meanings.hpp"

namespace rtdata::postgresql {
namespace {

/// TCP keepalive on both sides: a missing peer is detected after a minute. In seconds, and a number of tries.
const std::string keepalive_idle = "30", keepalive_interval = "10", keepalive_count = "3";

struct FreeOptions {
  void operator()(PQconninfoOption* options) const noexcept { PQconninfoFree(options); }
};
using Options = std::unique_ptr<PQconninfoOption, FreeOptions>;

const char* value_of(const Options& options, std::string_view keyword) {
  for (const PQconninfoOption* option = options.get(); option != nullptr && option->keyword != nullptr; ++option) {
    if (option->keyword == keyword && option->val != nullptr) return option->val;
  }
  return "";
}

/// libpq's texts have several lines, and line ends at their ends.
std::string one_line(std::string_view text) {
  std::string line;
  for (const char c : text) {
    if (c == '\n' || c == '\t') {
      if (!line.empty() && line.back() != ' ') line += c == '\n' ? "; " : " ";
    } else {
      line += c;
    }
  }
  while (line.ends_with(' ') || line.ends_with(';')) line.pop_back();
  return line;
}

/// Takes the code out of "FATAL:  28P01: password ..." and what only the server's authors need.
std::string take_state(std::string& text) {
  std::string state;
  for (std::size_t at = text.find(": "); at != std::string::npos; at = text.find(": ", at + 1)) {
    const std::size_t begin = text.find_first_not_of(' ', at + 1);
    if (begin == std::string::npos || text.size() < begin + 6 || text[begin + 5] != ':') continue;
    const std::string_view code = std::string_view(text).substr(begin, 5);
    const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
    const auto is_of_code = [&](char c) { return is_digit(c) || (c >= 'A' && c <= 'Z'); };
    if (!std::all_of(code.begin(), code.end(), is_of_code)) continue;
    if (std::none_of(code.begin(), code.end(), is_digit)) continue;  // "FATAL"
    state = code;
    text.erase(begin, 7);
    break;
  }
  if (const auto place = text.find("; LOCATION:"); place != std::string::npos) text.erase(place);
  return state;
}

/// libpq's error for these options, without server and user. libpq has no call to check options only, so the host is
/// replaced by a path that is too long for a socket, at which libpq stops before it connects. So there is always an
/// error text.
std::string said_before_connecting(const PQconninfoOption* options) {
  const std::string no_place = "/" + std::string(300, 'x');
  std::vector<const char*> keywords{"host", "user", "password"};
  std::vector<const char*> values{no_place.c_str(), "x", "x"};
  constexpr std::string_view left_out[] = {"host", "hostaddr", "port", "user", "password", "passfile", "dbname"};
  for (; options != nullptr && options->keyword != nullptr; ++options) {
    if (options->val == nullptr ||
        std::find(std::begin(left_out), std::end(left_out), options->keyword) != std::end(left_out))
      continue;
    keywords.push_back(options->keyword);
    values.push_back(options->val);
  }
  keywords.push_back(nullptr);
  values.push_back(nullptr);
  const std::unique_ptr<PGconn, Clear> connection(PQconnectStartParams(keywords.data(), values.data(), 0));
  return connection == nullptr ? "" : one_line(PQerrorMessage(connection.get()));
}

/// The option that libpq refuses for any server; empty: none.
std::string refused_option(const Options& options) {
  for (const char* keyword :
       {"keepalives", "keepalives_idle", "keepalives_interval", "keepalives_count", "tcp_user_timeout"}) {
    const std::string_view value = value_of(options, keyword);  // libpq reads it when it has a socket
    int number = 0;
    const auto read = std::from_chars(value.data(), value.data() + value.size(), number);
    if (!value.empty() && (read.ec != std::errc{} || read.ptr != value.data() + value.size()))
      return "`" + std::string(keyword) + "` is a whole number, not \"" + std::string(value) + "\"";
  }
  // These may say where the server is, and it would be connected to.
  if (*value_of(options, "service") != '\0' || std::getenv("PGSERVICE") != nullptr ||
      std::getenv("PGHOSTADDR") != nullptr)
    return "";
  std::string said = said_before_connecting(options.get());
  return said == said_before_connecting(nullptr) ? "" : said;
}

std::string milliseconds(Duration duration) {
  return std::to_string(
      std::max<std::int64_t>(std::chrono::duration_cast<std::chrono::milliseconds>(duration).count(), 1));
}

std::string in_quotes(std::string_view text, char quote) {
  std::string out(1, quote);
  for (const char c : text) {
    if (c == quote) out += quote;
    out += c;
  }
  return out + quote;
}

}  // namespace

std::string quoted_name(std::string_view name) { return in_quotes(name, '"'); }
std::string literal(std::string_view text) { return in_quotes(text, '\''); }

std::string password_in(const std::string& url) {
  detail::libpq.load().or_throw();
  if (url.empty()) return {};
  const auto refuse = [](std::string why, const char* advice) {
    throw SetupError({Errc::bad_argument, "cannot connect", "`url`", std::move(why), advice});
  };
  char* why = nullptr;
  const Options options(PQconninfoParse(url.c_str(), &why));
  if (options == nullptr) {
    // The message of libpq may contain part of the URL, and so of a password.
    PQfreemem(why);
    refuse("libpq does not understand it",
           "write postgresql://user@host:port/database, with % and two digits for other characters");
  }
  constexpr std::string_view modes[] = {"", "disable", "allow", "prefer", "require", "verify-ca", "verify-full"};
  const std::string_view mode = value_of(options, "sslmode");
  if (std::find(std::begin(modes), std::end(modes), mode) == std::end(modes))
    refuse("there is no sslmode \"" + std::string(mode) + "\"",
           "choose disable, allow, prefer, require, verify-ca or verify-full");
  std::string_view ports = value_of(options, "port");  // one for each host
  for (bool is_more = !ports.empty(); is_more;) {
    const std::size_t end = ports.find(',');
    const std::string_view port = ports.substr(0, end);
    unsigned number = 1;
    const auto read = std::from_chars(port.data(), port.data() + port.size(), number);
    if (!port.empty() &&
        (read.ec != std::errc{} || read.ptr != port.data() + port.size() || number < 1 || number > 65535))
      refuse("there is no port " + std::string(port), "ports go from 1 to 65535");
    is_more = end != std::string_view::npos;
    if (is_more) ports.remove_prefix(end + 1);
  }
  if (std::string refused = refused_option(options); !refused.empty())
    refuse(std::move(refused), "see \"Parameter Key Words\" in the manual of libpq");
  return value_of(options, "password");
}

std::int64_t Reply::integer(int row, int column) const noexcept {
  const std::string_view digits = text(row, column);
  std::int64_t value = 0;
  std::from_chars(digits.data(), digits.data() + digits.size(), value);
  return value;
}

Connection::Connection(const Address& address) : timeout_(address.timeout) {
  secrets_ = {address.password, password_in(address.url)};
  const std::string port = address.port != 0 ? std::to_string(address.port) : "";
  const std::string patience = milliseconds(address.timeout);
  std::vector<const char*> keywords, values;
  const std::string name = address.name.empty() ? "rtdata" : address.name;
  const auto set = [&](const char* keyword, const std::string& value) {
    if (value.empty()) return;
    keywords.push_back(keyword);
    values.push_back(value.c_str());
  };
  // Settings before the URL are defaults; settings after it override it.
  set("application_name", name);
  set("keepalives_idle", keepalive_idle);
  set("keepalives_interval", keepalive_interval);
  set("keepalives_count", keepalive_count);
  set("tcp_user_timeout", patience);
  set("dbname", address.url);
  set("host", address.host);
  set("port", port);
  set("dbname", address.database);
  set("user", address.user);
  set("password", address.password);
  const std::string encoding = "UTF8";
  set("client_encoding", encoding);
  keywords.push_back(nullptr);
  values.push_back(nullptr);

  connection_.reset(PQconnectStartParams(keywords.data(), values.data(), 1));
  PGconn* const connection = connection_.get();
  if (connection == nullptr) throw SetupError({Errc::io_failed, doing_, "", "no memory", ""});
  PQsetNoticeProcessor(
      connection, [](void*, const char*) {}, nullptr);
  PQsetErrorVerbosity(connection, PQERRORS_VERBOSE);  // while connecting, only the text has the code
  const auto place = [&] {
    const auto text = [](const char* value) { return value != nullptr ? std::string(value) : std::string(); };
    std::string where = "server " + text(PQhost(connection));
    if (const std::string at = text(PQport(connection)); !at.empty()) where += ", port " + at;
    if (const std::string database = text(PQdb(connection)); !database.empty()) where += ", database " + database;
    return where;
  };
  const auto until = Clock::now() + address.timeout;
  for (PostgresPollingStatusType status = PGRES_POLLING_WRITING; status != PGRES_POLLING_OK;) {
    where_ = place();
    if (PQstatus(connection) == CONNECTION_BAD || status == PGRES_POLLING_FAILED) {
      std::string why = one_line(PQerrorMessage(connection));
      const std::string state = take_state(why);
      const Meaning meaning = state.empty() ? meaning_of_text(why) : meaning_of(state);
      end(meaning.code, std::move(why), meaning.advice);
    }
    wait(status == PGRES_POLLING_READING ? POLLIN : POLLOUT, until);
    status = PQconnectPoll(connection);
  }
  where_ = place();
  doing_ = "cannot use the server";
  PQsetErrorVerbosity(connection, PQERRORS_DEFAULT);
  PQsetnonblocking(connection, 1);
  const char* server_encoding = PQparameterStatus(connection, "server_encoding");
  if (server_encoding == nullptr || std::string_view(server_encoding) != "UTF8") {
    throw SetupError({Errc::bad_argument, "cannot use the database", where_,
                      std::string("its encoding is ") + (server_encoding != nullptr ? server_encoding : "not known") +
                          ", which cannot store every text",
                      "make a database with the encoding UTF8: createdb -E UTF8 -T template0"});
  }
  // The server's own limits are shorter than ours, so that the error has its reason.
  std::string sql = "SET statement_timeout=" + milliseconds(address.timeout * 4 / 5) +
                    ";SET lock_timeout=" + milliseconds(address.timeout / 2) +
                    ";SET idle_in_transaction_session_timeout=" + milliseconds(address.timeout * 2) +
                    ";SET DateStyle=ISO;SET TimeZone='UTC';SET standard_conforming_strings=on;"
                    "SET extra_float_digits=1;SET default_transaction_isolation='read committed'";
  if (!address.schema.empty()) sql += ";SET search_path=" + quoted_name(address.schema) + ",pg_catalog";
  // If the network fails, the server keeps the session with its locks until its own TCP gives up, by default after two
  // hours. Settings chosen by the administrator, or unknown to an older server, are not changed.
  sql += ";SELECT set_config(s.name, v.value, false) FROM pg_settings s JOIN (VALUES ('tcp_keepalives_idle', '" +
         keepalive_idle + "'), ('tcp_keepalives_interval', '" + keepalive_interval + "'), ('tcp_keepalives_count', '" +
         keepalive_count + "'), ('tcp_user_timeout', '" + patience +
         "')) v(name, value) ON s.name = v.name WHERE s.source = 'default'";
  // And where this very connection was the older one, it is not waited for.
  if (!address.name.empty())
    sql +=
        ";SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = current_user AND pid <> "
        "pg_backend_pid() AND application_name = " +
        literal(address.name);
  run(sql);
}

void Connection::end(Errc code, std::string why, const char* advice) {
  Error error{code, doing_, where_, detail::hidden(std::move(why), secrets_), advice};
  close();
  throw SetupError(std::move(error));
}

void Connection::lost() {
  std::string why = connection_ == nullptr ? "there is no connection" : one_line(PQerrorMessage(connection_.get()));
  if (why.empty()) why = "the server has closed the connection";
  end(Errc::disconnected, std::move(why), "it is tried again");
}

Error Connection::error_in(const PGresult* result, const char* what) {
  if (PQstatus(connection_.get()) == CONNECTION_BAD) lost();
  const char* state = PQresultErrorField(result, PG_DIAG_SQLSTATE);
  const char* constraint = PQresultErrorField(result, PG_DIAG_CONSTRAINT_NAME);
  const char* primary = PQresultErrorField(result, PG_DIAG_MESSAGE_PRIMARY);
  const char* more = PQresultErrorField(result, PG_DIAG_MESSAGE_DETAIL);
  const char* context = PQresultErrorField(result, PG_DIAG_CONTEXT);
  std::string why = one_line(primary != nullptr ? primary : PQerrorMessage(connection_.get()));
  if (more != nullptr) why += " (" + one_line(more) + ")";
  // The last line, where a trigger of the table has failed.
  const bool is_in_copy = context != nullptr && one_line(context).find("COPY ") != std::string::npos;
  if (is_in_copy) why += ", in " + one_line(context);
  const bool is_of_row = state != nullptr && is_in_copy && refuses_row(state, constraint != nullptr ? constraint : "");
  const Meaning meaning = is_of_row ? row_refused : meaning_of(state != nullptr ? state : "");
  if (state != nullptr) why += ", SQLSTATE " + std::string(state);
  return {meaning.code, what, where_, detail::hidden(std::move(why), secrets_), meaning.advice};
}

short Connection::wait(short events, Clock::time_point until) {
  for (;;) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(until - Clock::now()).count();
    pollfd ready{PQsocket(connection_.get()), events, 0};
    const int count = left > 0 ? ::poll(&ready, 1, static_cast<int>(std::min<std::int64_t>(left, 1 << 30))) : 0;
    if (count > 0) return ready.revents;
    if (count == 0) end(Errc::timed_out, "it does not answer", "it is tried again with a new connection");
    if (errno != EINTR) lost();
  }
}

PGresult* Connection::next() {
  const auto until = Clock::now() + timeout_;
  PGconn* const connection = connection_.get();
  for (;;) {
    const int flushed = PQflush(connection);
    if (flushed < 0) lost();
    if (flushed == 0 && PQisBusy(connection) == 0) return PQgetResult(connection);
    wait(static_cast<short>(POLLIN | (flushed > 0 ? POLLOUT : 0)), until);
    if (PQconsumeInput(connection) == 0) lost();
  }
}

void Connection::answers(int sent, const char* what, const std::function<void(Reply)>& take) {
  if (sent == 0) lost();
  std::optional<Error> error;
  while (PGresult* const result = next()) {
    Reply reply(result);
    switch (PQresultStatus(result)) {
      case PGRES_COMMAND_OK:
      case PGRES_TUPLES_OK:
      case PGRES_SINGLE_TUPLE:
      case PGRES_EMPTY_QUERY:
      case PGRES_COPY_IN:
        if (!error) take(std::move(reply));
        break;
      default:
        if (!error) error = error_in(result, what);
    }
  }
  if (error) throw SetupError(std::move(*error));
}

Reply Connection::query(const std::string& sql, std::span<const std::string> parameters) {
  std::vector<const char*> values;
  for (const std::string& parameter : parameters) values.push_back(parameter.c_str());
  Reply last(nullptr);
  answers(parameters.empty() ? PQsendQuery(connection_.get(), sql.c_str())
                             : PQsendQueryParams(connection_.get(), sql.c_str(), static_cast<int>(values.size()),
                                                 nullptr, values.data(), nullptr, nullptr, 0),
          doing_, [&](Reply reply) { last = std::move(reply); });
  return last;
}

void Connection::put(std::string_view data) {
  // With the five bytes of its head, what libpq sends in one call and without a rest.
  constexpr std::size_t piece = (std::size_t{64} << 10) - 5;
  PGconn* const connection = connection_.get();
  for (std::size_t at = 0; at < data.size(); at += piece) {
    // The buffer of libpq is limited: gives it no more before it is empty.
    const auto until = Clock::now() + timeout_;
    for (int flushed = PQflush(connection); flushed != 0; flushed = PQflush(connection)) {
      if (flushed < 0) lost();
      if ((wait(POLLIN | POLLOUT, until) & ~POLLOUT) != 0 && PQconsumeInput(connection) == 0) lost();
    }
    const std::string_view now = data.substr(at, piece);
    if (PQputCopyData(connection, now.data(), static_cast<int>(now.size())) < 0) lost();
  }
}

void Connection::copy(const std::string& sql, std::span<const std::string_view> data) {
  std::size_t given = 0;
  answers(PQsendQuery(connection_.get(), sql.c_str()), "cannot store", [&](const Reply& reply) {
    if (PQresultStatus(reply.raw()) != PGRES_COPY_IN) return;
    put(data[given++]);
    if (PQputCopyEnd(connection_.get(), nullptr) < 0) lost();
  });
}

void Connection::each(const std::string& sql, const std::function<void(const Reply&)>& row) {
  constexpr int binary = 1;
  const int sent = PQsendQueryParams(connection_.get(), sql.c_str(), 0, nullptr, nullptr, nullptr, nullptr, binary);
  PQsetSingleRowMode(connection_.get());
  answers(sent, "cannot read from the server", [&](const Reply& reply) {
    if (PQresultStatus(reply.raw()) == PGRES_SINGLE_TUPLE) row(reply);
  });
}

void Connection::roll_back() noexcept {
  try {
    if (connection_ != nullptr && PQtransactionStatus(connection_.get()) != PQTRANS_IDLE) run("ROLLBACK");
  } catch (...) {
    close();
  }
}

}  // namespace rtdata::postgresql
