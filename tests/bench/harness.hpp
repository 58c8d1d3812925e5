// Harness of the benchmarks: runs the library ("value") and the least that the machine needs for the same work
// ("limit") interleaved, on one CPU, and gives the median of the ratios pair by pair; beside it, as a control, the same
// for limit against limit. A figure whose control strays further from 1 than its reach is called inconclusive.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace bench {

struct Figure {
  std::string name;
  std::string unit;
  double reach = 1;    // the ratio aimed at; 0: none, it is only reported
  double value = 0;    // median
  double limit = 0;    // median
  double ratio = 1;    // value / limit: 1 is the limit, lower is better
  double control = 1;  // limit / limit
  std::string note = {};
};

struct Options {
  std::vector<std::string> names;   // empty: all
  std::string json;                 // where to write; empty: nowhere
  std::string program;              // the program rtdata
  std::string memory = "/dev/shm";  // a folder on tmpfs
  std::string disk = ".";           // a folder on a disk
};

class Report {
 public:
  explicit Report(Options options) : options_(std::move(options)) {}
  const Options& options() const noexcept { return options_; }
  /// Whether the figure is asked for.
  bool wants(std::string_view name) const;
  void add(const Figure& figure);
  /// A line beside the figures, which goes into no file.
  void remark(const std::string& text) const;
  /// False when the file cannot be written.
  bool write_json() const;

 private:
  Options options_;
  std::vector<Figure> figures_;
};

/// One measurement gives a number for each figure.
using Measure = std::function<std::vector<double>()>;

/// What one round gives, a number for each figure: of the library, the limit, and the limit once more.
struct Round {
  std::vector<double> value, limit, again;
};
/// The number of the round is given. `figures` come with name, unit and reach.
std::vector<Figure> measure_rounds(std::vector<Figure> figures, const std::function<Round(int)>& round, int rounds);
/// Both are called once unmeasured, then in rounds of limit, value, limit, every second one in reverse.
std::vector<Figure> measure_pairs(std::vector<Figure> figures, const Measure& value, const Measure& limit,
                                  int pairs = 9);
Figure measure_pair(Figure figure, const std::function<double()>& value, const std::function<double()>& limit,
                    int pairs = 9);

double median(std::vector<double> values);
/// `fraction` 0.99: the 99th percentile. Reorders.
double percentile(std::vector<double>& values, double fraction);

std::int64_t monotonic_ns();
std::int64_t thread_cpu_ns();
std::int64_t process_cpu_ns();

/// The calling thread, and those that it starts, run on one CPU: the last of those allowed. Timer slack 1 ns.
void settle_thread();
/// Another allowed CPU where there is one, for a thread that is the outside world.
void settle_other_thread();
/// All CPUs that the program was given.
void unsettle_thread();

/// The result is used: nothing that leads to it is left out by the compiler.
template <class T>
inline void keep(const T& value) {
  asm volatile("" : : "r,m"(value) : "memory");
}

// One a subject; each adds those of its figures that are wanted.
void bench_loop(Report& report);
void bench_lanes(Report& report);
void bench_publish(Report& report);
void bench_iio(Report& report);
void bench_decoding(Report& report);
void bench_expression(Report& report);
void bench_machines(Report& report);
void bench_reactions(Report& report);
void bench_reload(Report& report);
void bench_filter(Report& report);
void bench_sinks(Report& report);
void bench_postgresql(Report& report);
void bench_network(Report& report);
void bench_disk(Report& report);
void bench_export(Report& report);
void bench_http(Report& report);
void bench_verify(Report& report);
void bench_retrieval(Report& report);
void bench_rocket(Report& report);
void bench_encoding(Report& report);
void bench_program(Report& report);
void bench_page(Report& report);
void bench_real_time(Report& report);
void bench_sending(Report& report);

}  // namespace bench
