// The files of the page for browsers; the build makes their text a part of the program.
#pragma once

#include <span>
#include <string_view>

namespace rtdata::app {

struct PageFile {
  std::string_view path;  ///< of the address: "/page.js"
  std::string_view type;  ///< of its content
  std::string_view text;
};
std::span<const PageFile> page_files();

}  // namespace rtdata::app
