// A plot as lines of text: braille, or ASCII if the terminal has no UTF-8.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "app/inspect/curve.hpp"

namespace rtdata::app {

struct PlotStyle {
  std::size_t columns = 80, rows = 24;  ///< of the terminal
  enum class Characters { ascii, braille };
  Characters characters = Characters::braille;
  enum class Colours { none, some };
  Colours colours = Colours::none;
};

/// The size of the terminal of standard output; none: 80 x 24 without colours. The locale says if it has UTF-8.
PlotStyle terminal_style();

/// The shortest step, with two digits, for which a picture in that style has room for all steps in this time.
Duration step_for(Time from, Time until, const PlotStyle& style);

/// A panel for each curve above one time axis. For each step the picture shows the range from least to most;
/// neighbours are joined, unless data between them is missing. Missing data has a letter below the curve, and each
/// letter a line with the reason. As many lines as the terminal has, more if the curves need them; none is
/// wider than it, except for words that are.
std::vector<std::string> picture_of(const Plot& plot, const PlotStyle& style);

}  // namespace rtdata::app
