/// Errors: one story from set-up to run time.
///
/// Set-up (constructors, loading a configuration) throws `SetupError`. Run time never throws: a function that may fail
/// returns `Result<T>`. An error of a running sensor or sink goes to its `on_error`, else to the loop's, else to the
/// log. Every error of this library carries an `Errc`; `id(Errc)` is its stable name, under which docs/errors.md
/// explains it.
///
///     rtdata::Result<rtdata::Rate> rate = rtdata::parse_rate(text);
///     if (!rate) std::cerr << rate.error().text_with_id() << '\n';   // what: where: why: what to do [id]
///     else sensor.set_rate(*rate);
///
/// Values; any thread.
#pragma once

#include <exception>
#include <stdexcept>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <variant>

namespace rtdata {

/// What kind of error it is. The numbers may change, the ids (see `id`) do not.
enum class Errc {
  ok = 0,
  bad_argument,         ///< a value given by the program is not usable
  bad_configuration,    ///< a configuration has mistakes
  bad_description,      ///< a payload's description is not usable (too large, a name twice, ...)
  description_differs,  ///< a topic or recording has another description under this name
  bad_name,             ///< a topic, sensor or field name that is not allowed
  not_found,            ///< a file or device that is not there
  not_permitted,        ///< the operating system refuses access
  busy,                 ///< another process holds it
  io_failed,            ///< the operating system reported a failure of a read or write
  disconnected,         ///< a device or peer went away
  timed_out,            ///< no answer in time
  not_a_number,         ///< text where a number was expected
  out_of_range,         ///< a number that the device or type cannot give
  bad_data,             ///< bytes that do not decode
  does_not_fit,         ///< a value too long for its place
  storage_full,         ///< no space left
  not_a_recording,      ///< a file that is not a recording of this library
  newer_version,        ///< written by a newer version
  damaged,              ///< a recording whose content is broken
  handler_threw,        ///< an exception left a user's callback
  held_too_long,        ///< a callback held its loop longer than its limit
  not_turning,          ///< a tier has stopped turning
  backlog,              ///< work arrives faster than it is done
  closed,               ///< the object is closed
};

/// The stable name of an error, such as "not-a-number". Never empty, never changes between versions.
std::string_view id(Errc code) noexcept;

const std::error_category& error_category() noexcept;
std::error_code make_error_code(Errc code) noexcept;

}  // namespace rtdata

template <>
struct std::is_error_code_enum<rtdata::Errc> : std::true_type {};

namespace rtdata {

/// One error, as a person reads it: what failed, where, why, and what to do about it. Any part but `what` may be empty.
struct Error {
  std::error_code code;
  std::string what;    ///< "cannot read the ADC file"
  std::string where;   ///< "sensor chamber, /sys/bus/iio/devices/iio:device0/in_voltage0_raw"
  std::string why;     ///< "No such file or directory"
  std::string advice;  ///< "check `file`; `ls /sys/bus/iio/devices` lists the converters"

  /// "what: where: why: advice", empty parts left out.
  std::string text() const;
  /// What a person is shown: text() and the id, "what: where: why: advice [not-found]".
  std::string text_with_id() const;
  /// The stable id ("not-found"), or "system" for an error code of another category.
  std::string_view id() const noexcept;

  bool operator==(const Error&) const = default;
};

/// The error of the operating system's `errno_value`, with the `Errc` that fits it and `why` filled in.
Error system_error(int errno_value, std::string what, std::string where, std::string advice = {});

/// Thrown by set-up only. `what()` is `error().text_with_id()`.
class SetupError : public std::runtime_error {
 public:
  explicit SetupError(Error error);
  const Error& error() const noexcept { return error_; }

 private:
  Error error_;
};

namespace detail {
/// `text` and, unless it is empty, the id in brackets.
std::string with_id(std::string text, std::string_view id);
/// `what()`; of a SetupError without its id: for a part of another error, which has an id of its own.
std::string_view reason_of(const std::exception& thrown) noexcept;
}  // namespace detail

/// A value or an error. Use: `if (!r) return r.error(); use(*r);` Reading the value of a failed result, or the error of
/// a good one, is undefined (asserted in debug builds).
template <class T>
class [[nodiscard]] Result {
 public:
  Result(T value) : content_(std::in_place_index<0>, std::move(value)) {}
  Result(Error error) : content_(std::in_place_index<1>, std::move(error)) {}

  bool has_value() const noexcept { return content_.index() == 0; }
  explicit operator bool() const noexcept { return has_value(); }
  T& value() & { return *std::get_if<0>(&content_); }
  const T& value() const& { return *std::get_if<0>(&content_); }
  T&& value() && { return std::move(*std::get_if<0>(&content_)); }
  T& operator*() & { return value(); }
  const T& operator*() const& { return value(); }
  T&& operator*() && { return std::move(*this).value(); }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }
  Error& error() & { return *std::get_if<1>(&content_); }
  const Error& error() const& { return *std::get_if<1>(&content_); }
  Error&& error() && { return std::move(*std::get_if<1>(&content_)); }

  /// The value; a failed result throws `SetupError` with its error. For set-up code and small programs.
  T& or_throw() & {
    if (!has_value()) throw SetupError(error());
    return value();
  }
  T or_throw() && {  // by value: it outlives the result in the head of a for loop
    if (!has_value()) throw SetupError(std::move(*this).error());
    return std::move(*this).value();
  }

 private:
  std::variant<T, Error> content_;
};

/// Success, or an error.
template <>
class [[nodiscard]] Result<void> {
 public:
  Result() noexcept {}  // not defaulted: otherwise `return {}` would first fill the memory with zeros
  Result(Error error) : content_(std::move(error)) {}

  bool has_value() const noexcept { return content_.index() == 0; }
  explicit operator bool() const noexcept { return has_value(); }
  Error& error() & { return *std::get_if<1>(&content_); }
  const Error& error() const& { return *std::get_if<1>(&content_); }
  Error&& error() && { return std::move(*std::get_if<1>(&content_)); }
  void or_throw() const {
    if (!has_value()) throw SetupError(error());
  }

 private:
  std::variant<std::monostate, Error> content_;
};

}  // namespace rtdata
