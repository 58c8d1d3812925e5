#include "config/plan/warnings.hpp"

#include <fcntl.h>
#include <linux/magic.h>
#include <sys/stat.h>
#include <sys/statfs.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <filesystem>
#include <system_error>

#include "config/plan/written_file.hpp"
#include "config/read/mistakes.hpp"
#include "data/listed.hpp"
#include "data/ucum.hpp"
#include "rtdata/config/read.hpp"

namespace rtdata::config_detail {
namespace {

/// Functions to call for each value of a parameter that is not a list or map, and for a parameter without effect
/// because of another parameter's value `is`.
struct Use {
  std::function<void(const ParameterInfo& parameter, const ConfigItem& leaf)> leaf;
  std::function<void(const ParameterInfo& parameter, const ConfigItem& value, const std::string& is)> no_effect = {};
};

void for_each_given(const std::vector<ParameterInfo>& parameters, const ConfigItem& item, const Use& use);

void descend(const ParameterInfo& parameter, const ParameterType& type, const ConfigItem& item, const Use& use) {
  if (type.kind == ParameterType::Kind::list || type.kind == ParameterType::Kind::map) {
    for (const ConfigChild& child : item.children()) descend(parameter, type.element.at(0), child.item, use);
  } else if (type.kind == ParameterType::Kind::object) {
    for_each_given(type.members, item, use);
  } else {
    use.leaf(parameter, item);
  }
}

/// Visits each parameter that is set in the item, and those below it.
void for_each_given(const std::vector<ParameterInfo>& parameters, const ConfigItem& item, const Use& use) {
  for (const ParameterInfo& parameter : parameters) {
    const ConfigItem* value = child_of(item, parameter.key);
    if (value == nullptr || value->is_null()) continue;
    descend(parameter, parameter.type, *value, use);
    if (!use.no_effect || parameter.only_with.key.empty()) continue;
    const auto& [key, wanted] = parameter.only_with;
    const auto other = std::find_if(parameters.begin(), parameters.end(),
                                    [name = key](const ParameterInfo& info) { return info.key == name; });
    const ConfigItem* said = child_of(item, key);
    if (said == nullptr && other != parameters.end()) said = &other->default_value;
    const bool* flag = said != nullptr ? said->as_boolean() : nullptr;
    const std::string* text = said != nullptr ? said->as_string() : nullptr;
    const std::string is = flag != nullptr ? (*flag ? "true" : "false") : text != nullptr ? *text : "";
    if (is.empty() || std::find(wanted.begin(), wanted.end(), std::string_view(is)) != wanted.end()) continue;
    use.no_effect(parameter, *value, is);
  }
}

void warn_of_placeholders(const ParameterInfo& parameter, const ConfigItem& item, const std::string& text,
                          Problems& warnings) {
  for (auto open = text.find('{'); open != std::string::npos; open = text.find('{', open + 1)) {
    const auto close = text.find('}', open);
    if (close == std::string::npos) return;
    const std::string name = text.substr(open + 1, close - open - 1);
    const auto& known = parameter.placeholders;
    if (std::find(known.begin(), known.end(), name) != known.end()) continue;
    std::string message = "{" + name + "} has no meaning here, and stays in the file's name";
    if (!known.empty()) message += "; known is {" + detail::listed(known, "}, {") + "}";
    std::string nearest = nearest_name(name, known);
    warnings.add(item.problem("unknown-placeholder", std::move(message), nearest.empty() ? "" : "{" + nearest + "}"));
  }
}

/// True for folders of the kernel, in which no file can be created.
bool is_of_kernel(const std::string& folder) {
  struct statfs about {};
  if (::statfs(folder.c_str(), &about) != 0) return false;
  constexpr std::array<std::uint32_t, 8> systems{PROC_SUPER_MAGIC,    SYSFS_MAGIC,       CGROUP_SUPER_MAGIC,
                                                 CGROUP2_SUPER_MAGIC, DEBUGFS_MAGIC,     TRACEFS_MAGIC,
                                                 SECURITYFS_MAGIC,    DEVPTS_SUPER_MAGIC};
  return std::find(systems.begin(), systems.end(), static_cast<std::uint32_t>(about.f_type)) != systems.end();
}

bool has_placeholder(const ParameterInfo& parameter, const std::string& folder) {
  return std::any_of(parameter.placeholders.begin(), parameter.placeholders.end(),
                     [&](const std::string& name) { return folder.find("{" + name + "}") != std::string::npos; });
}

void check_output_file(const ParameterInfo& parameter, const ConfigItem& leaf, Problems& problems) {
  const bool is_secret = is_secret_reference(leaf);
  std::string path;
  Problems ignored;  // reported when it was read
  if (is_secret) {
    if (!resolve_secret(leaf, path, ignored)) return;
  } else if (const std::string* text = leaf.as_string()) {
    path = *text;
  }
  if (path.empty() || path == "-" || path.find('\0') != std::string::npos) return;
  const std::string shown = is_secret ? "the file" : "\"" + path + "\"";
  const auto refuse = [&](const std::string& why) { problems.add(leaf.problem("cannot-write", why)); };
  const std::filesystem::path parsed(path);
  const std::string folder = parsed.has_parent_path() ? parsed.parent_path().string() : ".";
  struct stat about {};
  const bool is_there = ::stat(path.c_str(), &about) == 0;
  if (!is_there && (errno == ENAMETOOLONG || errno == ELOOP))
    return refuse(shown + " cannot be written: " + std::generic_category().message(errno));
  if (is_there && S_ISDIR(about.st_mode)) return refuse(shown + " is a folder: give the name of a file in it");
  if (is_there && !S_ISREG(about.st_mode)) return refuse(shown + " is not a regular file: give the path of a file");
  if (!parsed.has_filename()) return refuse(shown + " names no file: give the name of a file");
  if (is_of_kernel(folder)) return refuse(shown + " cannot be written: the kernel allows no new file in its folder");
  if (is_there && ::faccessat(AT_FDCWD, path.c_str(), R_OK | W_OK, AT_EACCESS) != 0)
    return refuse(shown + " cannot be written: " + std::generic_category().message(errno));
  if (is_there) return;
  if (has_placeholder(parameter, folder))
    return refuse("a placeholder is in the name of a folder; put the placeholder into the name of the file");
  struct stat link {};
  const bool is_link = ::lstat(path.c_str(), &link) == 0;  // its target does not exist and will be created
  const std::string made_in = is_link ? std::filesystem::path(FileIdentity(path).target()).parent_path().string()
                                      : folder;
  struct stat about_folder {};
  if (::stat(made_in.c_str(), &about_folder) != 0 || !S_ISDIR(about_folder.st_mode))
    return refuse("there is no folder " + (is_secret ? "for the file" : "\"" + made_in + "\"") +
                  (is_link ? ", to which " + shown + " is a symbolic link" : "") + ": make it first");
  if (is_of_kernel(made_in)) return refuse(shown + " cannot be written: the kernel allows no new file in its folder");
  if (::faccessat(AT_FDCWD, made_in.c_str(), W_OK | X_OK, AT_EACCESS) != 0)
    refuse("no file can be made in the folder of " + shown + ": " + std::generic_category().message(errno));
}

bool names_a_secret(std::string_view key) {
  std::string plain;  // apiKey, api_key and API-Key are equal
  for (const char c : key) {
    if (c >= 'A' && c <= 'Z') plain += static_cast<char>(c | 0x20);
    if ((c >= 'a' && c <= 'z') || (c >= '0' && c <= '9')) plain += c;
  }
  constexpr std::array<std::string_view, 11> words{"password",  "passwd",     "passphrase",   "pwd",
                                                   "secret",    "token",      "apikey",       "privatekey",
                                                   "accesskey", "credential", "authorization"};
  return std::any_of(words.begin(), words.end(),
                     [&](std::string_view word) { return plain.find(word) != std::string::npos; });
}

/// "https://user:password@host".
bool holds_a_password(std::string_view text) {
  const auto scheme = text.find("://");
  if (scheme == std::string_view::npos) return false;
  const std::string_view authority = text.substr(scheme + 3, text.find('/', scheme + 3) - scheme - 3);
  const auto at = authority.rfind('@');
  if (at == std::string_view::npos) return false;
  const auto colon = authority.substr(0, at).find(':');
  return colon != std::string_view::npos && colon + 1 < at;
}

void look_for_secrets(std::string_view key, const ConfigItem& item, Problems& warnings) {
  if (const std::string* text = item.as_string()) {
    if (text->empty() || (!names_a_secret(key) && !holds_a_password(*text))) return;
    warnings.add(item.problem("plain-secret",
                              "this looks like a secret, and recordings keep the text of the configuration: write "
                              "{\"env\": \"NAME\"} or {\"file\": \"path\"} in its place"));
    return;
  }
  if (is_secret_reference(item)) return;
  for (const ConfigChild& child : item.children())
    look_for_secrets(child.key.empty() ? key : child.key, child.item, warnings);
}

}  // namespace

void for_each_text(const std::vector<ParameterInfo>& parameters, const ConfigItem& item,
                   const std::function<void(const ParameterInfo&, const std::string&, const ConfigItem&)>& use) {
  for_each_given(parameters, item, {[&](const ParameterInfo& parameter, const ConfigItem& leaf) {
                   if (const std::string* text = leaf.as_string()) use(parameter, *text, leaf);
                 }});
}

void warn_of(const std::vector<ParameterInfo>& parameters, const ConfigItem& item, Problems& warnings) {
  const auto warn_of_text = [&](const ParameterInfo& parameter, const ConfigItem& leaf) {
    const std::string* const text = leaf.as_string();
    const ParameterType& type = parameter.type;
    const bool is_unit = (type.element.empty() ? type : type.element.front()).text == TextIs::unit;
    if (text != nullptr && is_unit && !detail::is_ucum(*text))
      warnings.add(
          leaf.problem("unknown-unit", "\"" + *text + "\" is not a unit of UCUM (ucum.org)", detail::ucum_for(*text)));
    if (text != nullptr && type.text == TextIs::output_file) warn_of_placeholders(parameter, leaf, *text, warnings);
  };
  const auto warn_of_no_effect = [&](const ParameterInfo& parameter, const ConfigItem& value, const std::string& is) {
    Problem problem = value.problem("no-effect", "it has no effect with `" + std::string(parameter.only_with.key) +
                                                     "` " + is + ", only with " +
                                                     detail::listed(parameter.only_with.values));
    problem.place = value.key_place();
    warnings.add(std::move(problem));
  };
  for_each_given(parameters, item, {warn_of_text, warn_of_no_effect});
}

void warn_of_plain_secrets(const ConfigItem& item, Problems& warnings) { look_for_secrets("", item, warnings); }

void check_output_files(const std::vector<ParameterInfo>& parameters, const ConfigItem& item, Problems& problems) {
  for_each_given(parameters, item, {[&](const ParameterInfo& parameter, const ConfigItem& leaf) {
                   if (parameter.type.text == TextIs::output_file) check_output_file(parameter, leaf, problems);
                 }});
}

void collect_secrets(const std::vector<ParameterInfo>& parameters, const ConfigItem& item,
                     std::vector<std::string>& secrets) {
  for_each_given(parameters, item, {[&](const ParameterInfo& parameter, const ConfigItem& leaf) {
                   const ParameterType& type = parameter.type;
                   const bool is_text = type.kind == ParameterType::Kind::string || !type.element.empty();
                   std::string secret;
                   Problems ignored;
                   if (is_text && is_secret_reference(leaf) && resolve_secret(leaf, secret, ignored))
                     secrets.push_back(std::move(secret));
                 }});
}

}  // namespace rtdata::config_detail
