#include <map>
#include <ostream>
#include <string>

#include "app/core/recording_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/chosen_fields.hpp"
#include "app/inspect/names.hpp"
#include "app/inspect/plot_picture.hpp"
#include "app/inspect/recorded_curves.hpp"
#include "app/inspect/recorded_range.hpp"

namespace rtdata::app {

int plot(const PlotOptions& options, std::ostream& out, std::ostream& err) try {
  auto opened = Recording::open(options.database);
  if (!opened) {
    print_error(err, opened.error());
    return 2;
  }
  const Recording& recording = *opened;
  const PlotStyle style = terminal_style();
  const RecordedRange range = range_of(recording, options.part, "cannot plot");
  if (options.fields.empty()) {
    std::map<std::string, std::vector<std::string>> by_topic;
    for (ChosenField& field : fields_of_run(recording, range.run)) by_topic[field.topic].push_back(field.path);
    out << list_of_fields(by_topic, "rtdata plot " + options.database);
    return 0;
  }
  const auto topics = recording.topics().or_throw();
  const auto fields = chosen_fields(options.fields, topics);
  const Plot of = curves_of(recording, range, fields, options.origin, step_for(range.from, range.until, style));
  for (const std::string& line : picture_of(of, style)) out << line << "\n";
  return 0;
} catch (const SetupError& error) {
  print_error(err, error.error());
  return error.error().code == make_error_code(Errc::damaged) ? 2 : 1;
}

}  // namespace rtdata::app
