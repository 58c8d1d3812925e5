#include "config/plan/written_file.hpp"

#include <sys/stat.h>

#include <charconv>
#include <filesystem>
#include <string_view>
#include <system_error>

#include "config/read/mistakes.hpp"

namespace rtdata::config_detail {
namespace {

namespace fs = std::filesystem;

constexpr int most_links = 40;  // as many as the kernel follows

fs::path resolved(const fs::path& path) {
  std::error_code failed;
  fs::path found = fs::weakly_canonical(path, failed);
  return failed || found.empty() ? path.lexically_normal() : found;
}

/// Absolute, the links of its folders resolved.
fs::path named(const fs::path& path) {
  std::error_code ignored;
  const fs::path whole = fs::absolute(path, ignored);
  const fs::path last = whole.filename();
  if (last.empty() || last == "." || last == "..") return resolved(whole);
  return resolved(whole.parent_path()) / last;
}

/// Follows the path's own links, also to a missing target, where the file will be created.
fs::path followed(fs::path at) {
  std::error_code failed;
  for (int links = 0; links < most_links; ++links) {
    const fs::path next = fs::read_symlink(at, failed);
    if (failed) break;
    at = named(at.parent_path() / next);
  }
  return at;
}

}  // namespace

FileIdentity::FileIdentity(const std::string& path)
    : name_(named(path).string()), target_(followed(name_).string()), id_(id_of(target_, links_)) {}

std::optional<FileIdentity::Id> FileIdentity::id_of(const std::string& path, nlink_t& links) noexcept {
  struct stat about {};
  if (::stat(path.c_str(), &about) != 0) return std::nullopt;
  links = about.st_nlink;
  return Id{about.st_dev, about.st_ino};
}

bool FileIdentity::is_same(const FileIdentity& other) const noexcept {
  return target_ == other.target_ || (id_ && id_ == other.id_);
}

bool FileIdentity::is_companion_file(
    const FileIdentity& main,
    const std::function<bool(const std::string& file, const std::string& other)>& is_companion_file) const {
  if (!is_companion_file) return false;
  for (const std::string& file : {main.name_, main.target_}) {
    if (is_companion_file(file, name_) || is_companion_file(file, target_)) return true;
    if (id_ && links_ > 1) {  // an existing file may be a hard link to this one
      std::error_code failed;
      const fs::path folder = fs::path(file).parent_path();
      for (fs::directory_iterator entry(folder, failed), end; !failed && entry != end; entry.increment(failed)) {
        nlink_t links = 0;
        const std::string there = entry->path().string();
        if (is_companion_file(file, there) && id_of(there, links) == id_) return true;
      }
    }
    if (main.name_ == main.target_) break;
  }
  return false;
}

WrittenFile written_file(const PartPlan& part, const std::string& path) {
  return {path, "the " + part.kind + " at " + place_of(part.item), part.stores->is_companion_file};
}

std::string conflict(const WrittenFile& file, const WrittenFile& known) {
  if (file.identity.is_same(known.identity))
    return known.writer + " writes \"" + known.path + "\" already; two writers on one file destroy it; choose another";
  if (file.identity.is_companion_file(known.identity, known.is_companion_file))
    return "\"" + file.path + "\" is a file that " + known.writer + " keeps beside \"" + known.path +
           "\"; choose another";
  if (known.identity.is_companion_file(file.identity, file.is_companion_file))
    return "\"" + known.path + "\", which " + known.writer + " writes, would be taken for a file beside \"" +
           file.path + "\"; choose another";
  return "";
}

bool is_rotated_log(const LogSettings& settings, const std::string& file, const std::string& other) {
  if (settings.max_bytes == 0 || !other.starts_with(file + ".")) return false;
  const std::string_view digits = std::string_view(other).substr(file.size() + 1);
  unsigned number = 0;
  const auto read = std::from_chars(digits.data(), digits.data() + digits.size(), number);
  return read.ec == std::errc{} && read.ptr == digits.data() + digits.size() && !digits.starts_with('0') &&
         number <= settings.keep;
}

}  // namespace rtdata::config_detail
