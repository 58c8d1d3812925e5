/// Secrets: texts of a configuration that are taken from elsewhere and never shown.
///
///     {"type": "...", "password": {"env": "BROKER_PASSWORD"}}
///     {"type": "...", "token": {"file": "/run/credentials/token"}}
///
/// Any text parameter may be written so, but for those that recordings hold. It is resolved when the configuration is
/// read; the line end at the end of a file does not count. What was resolved is not in the recorded configuration,
/// whose text keeps the reference, and is replaced by "(secret)" in errors, the log and the status
/// (Runtime::Config::secrets). A text of less than 4 bytes is not hidden: it would be found everywhere.
///
/// Errors: cannot-resolve (no such variable, file, or nothing in it), not-a-secret (a parameter that recordings hold).
/// Any thread. Reading a file blocks as the file system does.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/config_item.hpp"

namespace rtdata {

/// An object with one key, "env" or "file".
bool is_secret_reference(const ConfigItem& item) noexcept;
/// The text that the reference stands for. False when there is none, with a problem.
bool resolve_secret(const ConfigItem& reference, std::string& out, Problems& problems);
/// The text with each of the secrets, of at least 4 bytes, replaced by "(secret)".
std::string hide_secrets(std::string text, const std::vector<std::string>& secrets);

}  // namespace rtdata
