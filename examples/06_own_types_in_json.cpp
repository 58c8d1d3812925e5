// The program rtdata with a sensor and a sink type of one's own:  06_own_types_in_json run 06_own_types.json --for 1s
#include <cmath>
#include <cstdio>

#include "rtdata/app/program.hpp"

struct Wave {
  double value = 0;
  RTDATA_FIELDS(Wave, (value, "V"))
};
struct WaveConfig {
  double amplitude = 1;
  friend constexpr auto parameters(rtdata::type_tag<WaveConfig>) {
    return rtdata::parameter_list(
        rtdata::parameter("amplitude", &WaveConfig::amplitude, "height", rtdata::unit("V"), rtdata::range(0.0, 9.0)));
  }
};
struct TallyConfig {
  std::string path = {};
  rtdata::SinkConfig sink = {};
  friend constexpr auto parameters(rtdata::type_tag<TallyConfig>) {
    return rtdata::parameter_list(rtdata::parameter("path", &TallyConfig::path, "the file", rtdata::required),
                                  rtdata::include_member(&TallyConfig::sink));
  }
};
class Tally final : public rtdata::Writer {
 public:
  explicit Tally(std::string path) : path_(std::move(path)) {}
  rtdata::Result<void> open() override { return {}; }
  rtdata::Result<void> write(rtdata::Batch& batch) override {
    total_ += batch.size();
    std::FILE* file = std::fopen(path_.c_str(), "we");
    if (file == nullptr) return rtdata::system_error(errno, "cannot open the file", path_);
    std::fprintf(file, "%zu\n", total_);
    return std::fclose(file) == 0 ? rtdata::Result<void>() : rtdata::system_error(errno, "cannot write", path_);
  }

 private:
  std::string path_;
  std::size_t total_ = 0;
};

int main(int argc, char** argv) {
  rtdata::Registry registry = rtdata::standard_registry();
  registry.add_sensor<WaveConfig>(
      "wave", "a sine wave", [](const WaveConfig&) { return rtdata::description_of<Wave>(); },
      [](rtdata::Loop& loop, const rtdata::SensorConfig& common, const WaveConfig& config) {
        return rtdata::Sensor<Wave>(loop, common, [config, n = 0.0]() mutable {
          return Wave{config.amplitude * std::sin(2 * M_PI * n++ / 100)};
        });
      });
  registry.add_sink<TallyConfig>(
      "tally", "counts events", [](const TallyConfig& config) { return config.path; },
      [](rtdata::Loop& loop, const TallyConfig& config) {
        return rtdata::Sink(loop, config.sink, std::make_unique<Tally>(config.path));
      });
  return rtdata::run_program(registry, argc, argv);
}
