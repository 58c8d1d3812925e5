#include "harness.hpp"

#include <sched.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>

namespace bench {
namespace {

std::int64_t clock_ns(clockid_t clock) {
  timespec time{};
  ::clock_gettime(clock, &time);
  return std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

/// As allowed at the start of the program.
const cpu_set_t& allowed_cpus() {
  static const cpu_set_t cpus = [] {
    cpu_set_t set;
    CPU_ZERO(&set);
    ::sched_getaffinity(0, sizeof set, &set);
    return set;
  }();
  return cpus;
}

void settle_on(int wanted_from_last) {
  int chosen = -1;
  for (int cpu = CPU_SETSIZE - 1; cpu >= 0 && wanted_from_last >= 0; --cpu) {
    if (!CPU_ISSET(cpu, &allowed_cpus())) continue;
    chosen = cpu;
    --wanted_from_last;
  }
  if (chosen >= 0) {
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(chosen, &one);
    ::sched_setaffinity(0, sizeof one, &one);
  }
  ::prctl(PR_SET_TIMERSLACK, 1UL);
}

bool is_conclusive(const Figure& figure) {
  return std::abs(std::log(figure.control)) <= std::abs(std::log(figure.reach)) + 1e-9;
}

std::string number(double value) {
  char text[40];
  std::snprintf(text, sizeof text, std::abs(value) < 100 ? "%.4g" : "%.0f", value);
  return text;
}

}  // namespace

bool Report::wants(std::string_view name) const {
  return options_.names.empty() ||
         std::find(options_.names.begin(), options_.names.end(), name) != options_.names.end();
}

void Report::add(const Figure& figure) {
  if (figures_.empty()) {
    std::printf("%-18s %10s %10s  %-14s %7s %7s %7s\n", "figure", "value", "limit", "unit", "ratio", "control",
                "reach");
  }
  const char* verdict = figure.reach == 0                     ? "reported"
                        : !is_conclusive(figure)              ? "inconclusive"
                        : figure.ratio <= figure.reach + 1e-9 ? "reached"
                                                              : "missed";
  std::printf("%-18s %10s %10s  %-14s %7.3f %7.3f %7.2f  %s%s%s\n", figure.name.c_str(), number(figure.value).c_str(),
              number(figure.limit).c_str(), figure.unit.c_str(), figure.ratio, figure.control, figure.reach, verdict,
              figure.note.empty() ? "" : ": ", figure.note.c_str());
  std::fflush(stdout);
  figures_.push_back(figure);
}

void Report::remark(const std::string& text) const {
  std::printf("  %s\n", text.c_str());
  std::fflush(stdout);
}

bool Report::write_json() const {
  if (options_.json.empty()) return true;
  std::ofstream file(options_.json);
  file << "[";
  for (std::size_t i = 0; i < figures_.size(); ++i) {
    const Figure& f = figures_[i];
    char line[400];
    std::snprintf(line, sizeof line,
                  R"(%s  {"name": "%s", "unit": "%s", "value": %.6g, "limit": %.6g, "ratio": %.6g, "control": %.6g})",
                  i == 0 ? "\n" : ",\n", f.name.c_str(), f.unit.c_str(), f.value, f.limit, f.ratio, f.control);
    file << line;
  }
  file << "\n]\n";
  file.close();
  return file.good();
}

std::vector<Figure> measure_rounds(std::vector<Figure> figures, const std::function<Round(int)>& round, int rounds) {
  struct Series {
    std::vector<double> values, limits, ratios, controls;
  };
  std::vector<Series> series(figures.size());
  for (int number = 0; number < rounds; ++number) {
    const Round taken = round(number);
    for (std::size_t i = 0; i < figures.size(); ++i) {
      series[i].values.push_back(taken.value[i]);
      series[i].limits.push_back(taken.limit[i]);
      series[i].ratios.push_back(taken.value[i] / taken.limit[i]);
      series[i].controls.push_back(taken.again[i] / taken.limit[i]);
    }
  }
  for (std::size_t i = 0; i < figures.size(); ++i) {
    figures[i].value = median(series[i].values);
    figures[i].limit = median(series[i].limits);
    figures[i].ratio = median(series[i].ratios);
    figures[i].control = median(series[i].controls);
  }
  return figures;
}

std::vector<Figure> measure_pairs(std::vector<Figure> figures, const Measure& value, const Measure& limit, int pairs) {
  limit();
  value();
  const auto round = [&](int number) {
    const auto before = limit();
    const auto ours = value();
    const auto after = limit();
    // The value comes after its limit as often as before it.
    return number % 2 == 0 ? Round{ours, before, after} : Round{ours, after, before};
  };
  return measure_rounds(std::move(figures), round, pairs);
}

Figure measure_pair(Figure figure, const std::function<double()>& value, const std::function<double()>& limit,
                    int pairs) {
  const auto as_vector = [](const std::function<double()>& measure) {
    return [&measure] { return std::vector<double>{measure()}; };
  };
  return measure_pairs({std::move(figure)}, as_vector(value), as_vector(limit), pairs).front();
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t middle = values.size() / 2;
  return values.size() % 2 == 1 ? values[middle] : (values[middle - 1] + values[middle]) / 2;
}

double percentile(std::vector<double>& values, double fraction) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(fraction * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

std::int64_t monotonic_ns() { return clock_ns(CLOCK_MONOTONIC); }
std::int64_t thread_cpu_ns() { return clock_ns(CLOCK_THREAD_CPUTIME_ID); }
std::int64_t process_cpu_ns() { return clock_ns(CLOCK_PROCESS_CPUTIME_ID); }

void settle_thread() { settle_on(0); }
void settle_other_thread() { settle_on(1); }
void unsettle_thread() { ::sched_setaffinity(0, sizeof(cpu_set_t), &allowed_cpus()); }

namespace {

int usage() {
  std::fputs("usage: rtdata_bench [--json FILE] [--program FILE] [--disk FOLDER] [NAME...]\n", stderr);
  return 2;
}

int run(int count, char** arguments) {
  Options options;
  for (int i = 1; i < count; ++i) {
    const std::string_view argument = arguments[i];
    std::string* takes = argument == "--json"      ? &options.json
                         : argument == "--program" ? &options.program
                         : argument == "--disk"    ? &options.disk
                                                   : nullptr;
    if (takes != nullptr) {
      if (++i == count) return usage();
      *takes = arguments[i];
    } else if (argument.starts_with("-")) {
      return usage();
    } else {
      options.names.emplace_back(argument);
    }
  }
  if (::access(options.memory.c_str(), W_OK) != 0) options.memory = "/tmp";
  settle_thread();
  Report report(std::move(options));
  bench_publish(report);
  bench_decoding(report);
  bench_expression(report);
  bench_machines(report);
  bench_reactions(report);
  bench_reload(report);
  bench_filter(report);
  bench_encoding(report);
  bench_iio(report);
  bench_loop(report);
  bench_lanes(report);
  bench_sinks(report);
  bench_postgresql(report);
  bench_network(report);
  bench_disk(report);
  bench_export(report);
  bench_http(report);
  bench_verify(report);
  bench_retrieval(report);
  bench_rocket(report);
  bench_program(report);
  bench_page(report);
  bench_real_time(report);
  bench_sending(report);
  if (report.write_json()) return 0;
  std::fprintf(stderr, "cannot write %s\n", report.options().json.c_str());
  return 1;
}

}  // namespace
}  // namespace bench

int main(int count, char** arguments) { return bench::run(count, arguments); }
