#include "rtdata/data/error.hpp"

#include <cerrno>
#include <cstring>
#include <initializer_list>

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
  switch (code) {
    case Errc::ok:
      return "ok";
    case Errc::bad_argument:
      return "bad-argument";
    case Errc::bad_configuration:
      return "bad-configuration";
    case Errc::bad_description:
      return "bad-description";
    case Errc::description_differs:
      return "description-differs";
    case Errc::bad_name:
      return "bad-name";
    case Errc::not_found:
      return "not-found";
    case Errc::not_permitted:
      return "not-permitted";
    case Errc::busy:
      return "busy";
    case Errc::io_failed:
      return "io-failed";
    case Errc::disconnected:
      return "disconnected";
    case Errc::timed_out:
      return "timed-out";
    case Errc::not_a_number:
      return "not-a-number";
    case Errc::out_of_range:
      return "out-of-range";
    case Errc::bad_data:
      return "bad-data";
    case Errc::does_not_fit:
      return "does-not-fit";
    case Errc::storage_full:
      return "storage-full";
    case Errc::not_a_recording:
      return "not-a-recording";
    case Errc::newer_version:
      return "newer-version";
    case Errc::damaged:
      return "damaged";
    case Errc::handler_threw:
      return "handler-threw";
    case Errc::held_too_long:
      return "held-too-long";
    case Errc::not_turning:
      return "not-turning";
    case Errc::backlog:
      return "backlog";
    case Errc::closed:
      return "closed";
  }
  return "unknown";
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
