#include "paths.hpp"

namespace rtdata::test {

std::string built(const std::string& name) { return RTDATA_BINARY_DIR "/" + name; }

std::string in_source(const std::string& path) { return RTDATA_SOURCE_DIR "/" + path; }

}  // namespace rtdata::test
