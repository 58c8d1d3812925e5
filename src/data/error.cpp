#include "rtdata/data/error.hpp"

#include <cerrno>
#include <cstring>
#include <initializer_list>
#include <iterator>

#include "data/name_in.hpp"

namespace rtdata {
namespace {

class Category final : public std::error_category {
 public:
  const char* name() const noexcept override { return "rtdata"; }
  std::string message(int code) const override { return std::string(rtdata::id(static_cast<Errc>(code))); }
};

Errc errc_of(int errno_value) {
  switch (errno_value) {
    case ENOENT:
    case ENOTDIR:
      return Errc::not_found;
    case ENODEV:
    case ENXIO:
    case EPIPE:
    case ECONNRESET:
      return Errc::disconnected;
    case EACCES:
    case EPERM:
    case EROFS:
      return Errc::not_permitted;
    case EBUSY:
      return Errc::busy;
    case ENOSPC:
    case EDQUOT:
      return Errc::storage_full;
    case ETIMEDOUT:
      return Errc::timed_out;
    case EINVAL:
      return Errc::bad_argument;
    default:
      return Errc::io_failed;
  }
}

}  // namespace

std::string_view id(Errc code) noexcept {
  constexpr std::string_view ids[] = {"ok",
                                      "bad-argument",
                                      "bad-configuration",
                                      "bad-description",
                                      "description-differs",
                                      "bad-name",
                                      "not-found",
                                      "not-permitted",
                                      "busy",
                                      "io-failed",
                                      "disconnected",
                                      "timed-out",
                                      "not-a-number",
                                      "out-of-range",
                                      "bad-data",
                                      "does-not-fit",
                                      "storage-full",
                                      "not-a-recording",
                                      "newer-version",
                                      "damaged",
                                      "handler-threw",
                                      "held-too-long",
                                      "not-turning",
                                      "backlog",
                                      "closed"};
  static_assert(std::size(ids) == static_cast<std::size_t>(Errc::closed) + 1);
  return detail::name_in(ids, code);
}

const std::error_category& error_category() noexcept {
  static const Category category;
  return category;
}

std::error_code make_error_code(Errc code) noexcept { return {static_cast<int>(code), error_category()}; }

std::string Error::text() const {
  std::string text;
  for (const std::string* part : {&what, &where, &why, &advice}) {
    if (part->empty()) continue;
    if (!text.empty()) text += ": ";
    text += *part;
  }
  return text;
}

std::string Error::text_with_id() const { return detail::with_id(text(), id()); }

std::string_view Error::id() const noexcept {
  return code.category() == error_category() ? rtdata::id(static_cast<Errc>(code.value())) : "system";
}

SetupError::SetupError(Error error) : std::runtime_error(error.text_with_id()), error_(std::move(error)) {}

namespace detail {

std::string with_id(std::string text, std::string_view id) {
  if (!id.empty()) text.append(" [").append(id).append("]");
  return text;
}

std::string_view reason_of(const std::exception& thrown) noexcept {
  std::string_view reason = thrown.what();
  if (const auto* const refused = dynamic_cast<const SetupError*>(&thrown))
    reason.remove_suffix(refused->error().id().size() + 3);  // " [id]"
  return reason;
}

}  // namespace detail

Error system_error(int errno_value, std::string what, std::string where, std::string advice) {
  return {errc_of(errno_value), std::move(what), std::move(where), std::generic_category().message(errno_value),
          std::move(advice)};
}

}  // namespace rtdata
