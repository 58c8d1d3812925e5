// The requests through the control socket, one line of JSON each, and the short answers. Private to the program.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace rtdata::app {

/// The reason why a line is not a status request; empty: it is one.
std::string refusal_of(std::string_view line);
/// The words of a command; empty: the line is not a command.
std::vector<std::string> command_words(std::string_view line);
/// The error of a request whose version this program does not know; empty: it knows it.
std::string refusal_of_version(const nlohmann::ordered_json& request);
/// {"KEY":"TEXT"}, without a line's end.
std::string answer_line(std::string_view key, std::string_view text);

}  // namespace rtdata::app
