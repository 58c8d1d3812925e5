#include "app/control/request.hpp"

#include <cstddef>
#include <nlohmann/json.hpp>

#include "app/control/status.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t longest_request = 4096;

}  // namespace

std::string refusal_of(std::string_view line) {
  if (line.size() > longest_request) return "a request has at most " + std::to_string(longest_request) + " bytes";
  const Json request = Json::parse(line, nullptr, false);
  if (request.is_discarded() || !request.is_object()) return "a request is an object of JSON on one line";
  const auto what = request.find("request");
  if (what == request.end() || !what->is_string()) return "the object has no key \"request\"";
  if (std::string why = refusal_of_version(request); !why.empty()) return why;
  if (*what == "command") return "\"words\" of a command must be a list of at least one string";
  if (*what != "status")
    return "there is no request \"" + what->get<std::string>() +
           "\"; available: \"status\", \"command\" and \"subscribe\"";
  return {};
}

std::string refusal_of_version(const Json& request) {
  const Json version = request.value("version", Json(Status::newest));
  if (version <= Status::newest) return {};
  return "the request is in version " + version.dump(-1, ' ', false, Json::error_handler_t::replace) +
         " of the protocol, and this program knows up to " + std::to_string(Status::newest) +
         ": use the version of the program that runs";
}

std::vector<std::string> command_words(std::string_view line) {
  const Json request = Json::parse(line, nullptr, false);
  std::vector<std::string> words;
  if (!request.is_object() || !request.contains("request") || request["request"] != "command") return words;
  if (!refusal_of_version(request).empty()) return words;
  const auto given = request.find("words");
  if (given == request.end() || !given->is_array()) return words;
  for (const Json& word : *given) {
    if (!word.is_string()) return {};
    words.push_back(word.get<std::string>());
  }
  return words;
}

std::string answer_line(std::string_view key, std::string_view text) {
  return Json{{key, text}}.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace rtdata::app
