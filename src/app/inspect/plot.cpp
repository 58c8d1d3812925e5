#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <ostream>
#include <set>
#include <string>
#include <string_view>

#include "app/core/recording_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/plot_picture.hpp"
#include "app/inspect/recorded_curves.hpp"

namespace rtdata::app {
namespace {

std::string_view variable(const char* name) {
  const char* const value = std::getenv(name);
  return value == nullptr ? std::string_view() : value;
}

/// Whether programs are to write UTF-8: the first of these variables that is set says so.
bool is_utf8_locale() {
  for (const char* const name : {"LC_ALL", "LC_CTYPE", "LANG"}) {
    const std::string_view value = variable(name);
    if (value.empty()) continue;
    for (const std::string_view utf8 : {"UTF-8", "utf-8", "UTF8", "utf8"})
      if (value.find(utf8) != std::string_view::npos) return true;
    return false;
  }
  return false;
}

PlotStyle style_of(int descriptor) {
  PlotStyle style;
  if (is_utf8_locale()) {
    style.characters = PlotStyle::Characters::braille;
  } else {
    style.characters = PlotStyle::Characters::ascii;
  }
  const std::size_t columns = columns_of(descriptor);
  if (columns == 0) return style;
  style.columns = columns;
  winsize size{};
  if (::ioctl(descriptor, TIOCGWINSZ, &size) == 0 && size.ws_row != 0) style.rows = size.ws_row;
  if (variable("NO_COLOR").empty() && variable("TERM") != "dumb") style.colours = PlotStyle::Colours::some;
  return style;
}

}  // namespace

int plot(const PlotOptions& options, std::ostream& out, std::ostream& err) try {
  auto opened = Recording::open(options.database);
  if (!opened) {
    err << "rtdata: " << opened.error().text() << "\n";
    return 2;
  }
  const Recording& recording = *opened;
  const PlotStyle style = style_of(STDOUT_FILENO);
  const RecordedRange range = range_of(recording, options.part, "cannot plot");
  const auto topics = recording.topics().or_throw();
  const auto fields = chosen_fields(options.fields, topics);
  const Plot of = curves_of(recording, range, fields, options.origin, step_for(range.from, range.until, style));
  for (const std::string& line : picture_of(of, style)) out << line << "\n";
  return 0;
} catch (const SetupError& error) {
  err << "rtdata: " << error.what() << "\n";
  return error.error().code == make_error_code(Errc::damaged) ? 2 : 1;
}

}  // namespace rtdata::app
