// What is asked through the control socket, a line of JSON each, and the short answers. Private to the program.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace rtdata::app {

/// Why what was asked is no request for a status; empty: it is one.
std::string refusal_of(std::string_view line);
/// The words of a request that is a command; empty: it is none.
std::vector<std::string> command_words(std::string_view line);
/// Why a request is of a version that this program does not know; empty: it knows it.
std::string refusal_of_version(const nlohmann::ordered_json& request);
/// {"KEY":"TEXT"}, without a line's end.
std::string answer_line(std::string_view key, std::string_view text);

}  // namespace rtdata::app
