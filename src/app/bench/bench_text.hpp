// How `rtdata bench` reads: its figures as text, and what follows from them.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace rtdata::app {

/// All of it, for people.
std::string bench_text(const nlohmann::ordered_json& figures);
/// One sentence for each rate and each folder.
nlohmann::ordered_json bench_verdict(const nlohmann::ordered_json& figures);

}  // namespace rtdata::app
