// Where the tests' own programs and data are. In one file of its own, so that what is compiled for one folder serves
// the compiler cache in another.
#pragma once

#include <string>

namespace rtdata::test {

/// The path of what the build made, such as "rtdata".
std::string built(const std::string& name);

/// The program.
inline const std::string program = built("rtdata");

/// A path in the source tree.
std::string in_source(const std::string& path);

}  // namespace rtdata::test
