#include "recording/database.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>

#include "data/utf8.hpp"

namespace rtdata::sqlite {
namespace {

constexpr int longest_value = 256 << 20;  // a damaged length asks for no more memory than this

Errc errc_of(int code) {
  switch (code & 0xff) {
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return Errc::busy;
    case SQLITE_FULL:
      return Errc::storage_full;
    case SQLITE_READONLY:
    case SQLITE_PERM:
    case SQLITE_AUTH:
      return Errc::not_permitted;
    case SQLITE_NOTADB:
      return Errc::not_a_recording;
    case SQLITE_CORRUPT:
      return Errc::damaged;
    case SQLITE_CANTOPEN:
      return Errc::not_found;
    default:
      return Errc::io_failed;
  }
}

const char* advice_of(Errc code) {
  switch (code) {
    case Errc::busy:
      return "another program holds a lock on it: close that one";
    case Errc::storage_full:
      return "make room; until then events wait in memory";
    case Errc::not_permitted:
      return "check the permissions of the file and its folder";
    case Errc::not_a_recording:
      return "it is not an SQLite file: choose another path";
    case Errc::damaged:
      return "keep it as it is, and record into another file";
    default:
      return "";
  }
}

/// The path as a file: URI, so that no character of it means anything.
std::string uri_of(const std::string& path, const char* parameters) {
  std::string uri = path.starts_with('/') ? "file://" : "file:";
  for (const char c : path) {
    constexpr char digits[] = "0123456789ABCDEF";
    if (c == '%' || c == '?' || c == '#') {
      uri += '%';
      uri += digits[c >> 4];
      uri += digits[c & 0xf];
    } else {
      uri += c;
    }
  }
  return uri + parameters;
}

}  // namespace

namespace {

/// True if the file cannot be read at all. SQLite also reports a file as damaged if its disk was removed.
bool is_unreadable(sqlite3* database) {
  sqlite3_file* file = nullptr;
  char byte = 0;
  return sqlite3_file_control(database, "main", SQLITE_FCNTL_FILE_POINTER, &file) == SQLITE_OK && file != nullptr &&
         file->pMethods != nullptr && (file->pMethods->xRead(file, &byte, 1, 0) & 0xff) == SQLITE_IOERR;
}

}  // namespace

Error error_of(sqlite3* database, std::string_view doing) {
  const int code = sqlite3_extended_errcode(database);
  const char* file = sqlite3_db_filename(database, "main");
  if ((code & 0xff) == SQLITE_CORRUPT && is_unreadable(database)) {
    return {Errc::io_failed, std::string(doing), file != nullptr ? file : "",
            "the disk does not answer: it cannot be read", "check the disk, or plug it in again and start again"};
  }
  const Errc kind = errc_of(code);
  std::string why = sqlite3_errmsg(database);
  if (const int system = sqlite3_system_errno(database); kind == Errc::io_failed && system != 0) {
    why += " (" + std::generic_category().message(system) + ")";
    if (system == ENOSPC)
      return {Errc::storage_full, std::string(doing), file != nullptr ? file : "", why, advice_of(Errc::storage_full)};
  }
  return {kind, std::string(doing), file != nullptr ? file : "", std::move(why), advice_of(kind)};
}

std::vector<std::string> columns_of(const Database& database, std::string_view table) {
  auto query = database.prepare("SELECT name FROM pragma_table_info(?) ORDER BY cid");
  return query.bind(1, table).texts();
}

std::string Quoted::operator()(std::string_view name) const {
  std::string text = "\"";
  for (const char c : name) {
    if (c == '"') text += '"';
    text += c;
  }
  return text + '"';
}

Statement& Statement::bind(int index, std::int64_t value) noexcept {
  sqlite3_bind_int64(raw(), index, value);
  return *this;
}
Statement& Statement::bind(int index, double value) noexcept {
  sqlite3_bind_double(raw(), index, value);
  return *this;
}
Statement& Statement::bind(int index, std::string_view value) {
  if (!detail::is_readable(value)) {
    const std::string text = detail::readable(value);
    sqlite3_bind_text64(raw(), index, text.data(), text.size(), SQLITE_TRANSIENT, SQLITE_UTF8);
    return *this;
  }
  sqlite3_bind_text64(raw(), index, value.data() != nullptr ? value.data() : "", value.size(), SQLITE_STATIC,
                      SQLITE_UTF8);
  return *this;
}
Statement& Statement::bind_null(int index) noexcept {
  sqlite3_bind_null(raw(), index);
  return *this;
}

bool Statement::step() {
  switch (sqlite3_step(raw())) {
    case SQLITE_ROW:
      return true;
    case SQLITE_DONE:
      return false;
    default: {
      const SetupError error(error_of(sqlite3_db_handle(raw()), "cannot use the recording"));
      sqlite3_reset(raw());
      throw error;
    }
  }
}

std::vector<std::string> Statement::texts() {
  std::vector<std::string> all;
  while (step()) {
    all.emplace_back(text(0));
  }
  return all;
}

void Statement::run() {
  while (step()) {
  }
  sqlite3_reset(raw());
}

void Statement::reset() noexcept { sqlite3_reset(raw()); }

std::int64_t Statement::integer(int column) const noexcept { return sqlite3_column_int64(raw(), column); }
double Statement::real(int column) const noexcept { return sqlite3_column_double(raw(), column); }
std::string_view Statement::text(int column) const noexcept {
  sqlite3_value* const value = sqlite3_column_value(raw(), column);  // no other thread uses the connection meanwhile
  const auto* bytes = reinterpret_cast<const char*>(sqlite3_value_text(value));
  return bytes == nullptr ? std::string_view{}
                          : std::string_view{bytes, static_cast<std::size_t>(sqlite3_value_bytes(value))};
}
bool Statement::is_null(int column) const noexcept { return sqlite3_column_type(raw(), column) == SQLITE_NULL; }

Database Database::open(const std::string& path, Mode mode, mode_t permissions) {
  struct stat status {};
  const bool is_there = ::stat(path.c_str(), &status) == 0;
  const bool is_read = mode != Mode::write;
  const char* doing = is_read ? "cannot read the recording" : "cannot open the recording";
  if (is_there && S_ISDIR(status.st_mode)) throw SetupError(system_error(EISDIR, doing, path, "name a file"));
  if (!is_there && is_read) throw SetupError(system_error(errno, doing, path, "check the path"));
  if (!is_there) {  // SQLite would let everybody read it; its log and its index of that follow
    const int fd = ::open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, permissions);
    if (fd >= 0) ::close(fd);
  }
  Database made;
  made.path_ = path;
  sqlite3* raw = nullptr;
  const int flags = SQLITE_OPEN_NOMUTEX |
                    (is_read ? SQLITE_OPEN_READONLY | SQLITE_OPEN_URI : SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE);
  const int status_code = sqlite3_open_v2(
      is_read ? uri_of(path, mode == Mode::read_at_rest ? "?immutable=1" : "").c_str() : path.c_str(), &raw, flags,
      nullptr);
  made.database_.reset(raw);
  if (raw == nullptr) throw SetupError(system_error(ENOMEM, doing, path, "free memory"));  // none for the handle either
  if (status_code != SQLITE_OK) {
    Error error = error_of(raw, doing);
    error.where = path;
    const int system = sqlite3_system_errno(raw);
    if (system != 0) error = system_error(system, doing, path, "check the path and its permissions");
    throw SetupError(std::move(error));
  }
  sqlite3_extended_result_codes(raw, 1);
  sqlite3_busy_timeout(raw, 2000);
  sqlite3_limit(raw, SQLITE_LIMIT_LENGTH, longest_value);
  return made;
}

Statement Database::prepare(std::string_view sql) const {
  sqlite3_stmt* raw = nullptr;
  if (sqlite3_prepare_v3(database_.get(), sql.data(), static_cast<int>(sql.size()), SQLITE_PREPARE_PERSISTENT, &raw,
                         nullptr) != SQLITE_OK) {
    throw SetupError(error_of(database_.get(), "cannot use the recording"));
  }
  return Statement(raw);
}

void Database::execute(const std::string& sql) const {
  if (sqlite3_exec(database_.get(), sql.c_str(), nullptr, nullptr, nullptr) != SQLITE_OK) {
    throw SetupError(error_of(database_.get(), "cannot use the recording"));
  }
}

std::int64_t Database::integer(std::string_view sql) const {
  auto statement = prepare(sql);
  return statement.step() ? statement.integer(0) : 0;
}

}  // namespace rtdata::sqlite
