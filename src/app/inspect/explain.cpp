#include <algorithm>
#include <iostream>
#include <string>
#include <string_view>
#include <vector>

#include "app/core/configuration_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/errors_page.hpp"
#include "rtdata/data/problem.hpp"

namespace rtdata::app {
namespace {

struct Section {
  std::string id;
  std::string_view text;  // in Markdown
};

std::vector<Section> sections_of(std::string_view page) {
  constexpr std::string_view mark = "\n### `";
  std::vector<Section> sections;
  for (std::size_t at = page.find(mark); at != std::string_view::npos;) {
    const std::size_t begin = at + mark.size();
    const std::size_t end = page.find('`', begin);
    const std::size_t text = page.find('\n', end) + 1;
    at = page.find(mark, text);
    sections.push_back({std::string(page.substr(begin, end - begin)),
                        page.substr(text, std::min(at, page.find("\n## ", text)) - text)});
  }
  return sections;
}

/// Removes the Markdown marks and joins the lines of a paragraph; the terminal output wraps it again.
std::string plain(std::string_view markdown) {
  std::string text;
  bool is_code = false;
  for (std::size_t i = 0; i < markdown.size(); ++i) {
    const std::string_view rest = markdown.substr(i);
    if (rest.starts_with("```") || rest.starts_with("<!--")) {
      is_code = is_code != (markdown[i] == '`');
      i += std::min(rest.find('\n'), rest.size() - 1);
    } else if (rest.starts_with("**")) {
      ++i;
    } else if (markdown[i] == '[' && rest.find("](") < rest.find(']') + 1) {  // a link: its text
      text += rest.substr(1, rest.find(']') - 1);
      i += rest.find(')', rest.find("]("));
    } else if (markdown[i] == '\n' && !is_code && rest.size() > 1 && rest[1] != '\n' && !text.ends_with('\n')) {
      text += ' ';
    } else if (markdown[i] != '`' || is_code) {
      text += markdown[i];
    }
  }
  text.erase(text.find_last_not_of('\n') + 1);
  return text;
}

}  // namespace

int explain(std::string id) {
  const std::vector<Section> sections = sections_of(errors_page);
  if (id.starts_with('[') && id.ends_with(']')) id = id.substr(1, id.size() - 2);  // as in a message
  std::vector<std::string> ids;
  for (const Section& section : sections) {
    if (section.id == id) {
      std::cout << id << "\n" << plain(section.text) << '\n';
      return exit_good;
    }
    ids.push_back(section.id);
  }
  if (id.empty()) {
    for (const std::string& each : ids) std::cout << each << '\n';
    return exit_good;
  }
  const std::string nearest = nearest_name(id, ids);
  print_error(std::cerr,
              "no error has the id \"" + id + "\"" +
                  (nearest.empty() ? "; `rtdata explain` lists them all" : "; did you mean \"" + nearest + "\"?"),
              "not-found");
  return exit_other;
}

}  // namespace rtdata::app
