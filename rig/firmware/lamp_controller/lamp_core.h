// The lamp controller without its board: protocol, exposures, interlock and watchdog.
//
// Everything happens in receive() and poll(), with the time handed in (microseconds since power-up), so that
// the same code runs on the board and in the tests, where hours pass in a moment. No heap, no floats: numbers
// are decimal integers from the line to the pin.
//
// Whatever decides an exposure (lit or not, level, mode) is taken at its start and held to its end.

#pragma once

#include <stddef.h>
#include <stdint.h>

namespace gonio {

constexpr char kFirmware[] = "1.0.0";
constexpr size_t kLongestLine = 256;
constexpr size_t kLongestId = 40;
constexpr uint8_t kErrorQueue = 16;
constexpr uint32_t kSampleEvery_us = 1000;
constexpr uint8_t kMonitorSamples = 100;  // 0.1 s
constexpr uint32_t kQuietBeforeEdge_us = 500;  // no photodiode reading this close to an edge: it would delay it
constexpr uint64_t kNever = UINT64_MAX;
constexpr uint32_t kFull_ppb = 1000000000;  // level 1

enum class Mode : uint8_t { kBulb, kWidth, kLamp };

enum class Error : uint8_t { kNone, kHeader, kRange, kRunning, kInterlock, kWatchdog, kOverflow };

struct Exposure {
  uint32_t exposure_us;
  uint32_t open_us;  // how long the shutter is open
  bool lit;
  uint32_t level_ppb;
  Mode mode;
  uint32_t shot;  // its number since power-up, from 1, if it completes
  char id[kLongestId + 1];
  uint64_t begin_us, end_us;
  uint64_t light_begin_us, light_end_us;  // empty if the lamp does not light it
};

// What the controller asks of the board it runs on.
class Board {
 public:
  virtual void light(bool on, uint32_t level_ppb) = 0;
  virtual void shutter(bool open) = 0;
  virtual uint16_t photodiode() = 0;        // 10000 = nominal
  virtual int16_t temperature() = 0;        // of the lamp head, tenths of a degree C
  virtual void send(char character) = 0;

 protected:
  ~Board() = default;
};

class LampController {
 public:
  LampController(Board& board, const char* serial, uint64_t now_us);

  void receive(char character, uint64_t now_us);
  void poll(uint64_t now_us);           // lets happen, in order, what was due until now
  uint64_t next_due_us() const;         // when something will happen by itself
  uint64_t next_edge_us() const;        // when light or shutter will change by themselves, watchdog apart
  void set_interlock(bool closed, uint64_t now_us);
  void forget_partial_line() { length_ = 0; }

  bool busy() const { return busy_; }
  uint32_t completed() const { return completed_; }
  const Exposure& exposure() const { return exposure_; }  // the running one, else the last

 private:
  using Command = Error (LampController::*)(const char* argument, uint64_t now_us);
  struct CommandRow {
    const char* header;
    Command run;
  };
  static const CommandRow kCommands[];

  void obey(uint64_t now_us);
  bool answer(const char* header, uint64_t now_us);
  Error reset(const char* argument, uint64_t now_us);
  Error set_output(const char* argument, uint64_t now_us);
  Error set_level(const char* argument, uint64_t now_us);
  Error set_mode(const char* argument, uint64_t now_us);
  Error set_open(const char* argument, uint64_t now_us);
  Error set_id(const char* argument, uint64_t now_us);
  Error set_watchdog(const char* argument, uint64_t now_us);
  Error expose(const char* argument, uint64_t now_us);
  Error expose_dark(const char* argument, uint64_t now_us);
  Error abort_command(const char* argument, uint64_t now_us);

  Error begin(const char* argument, bool lit, uint64_t now_us);
  void complete(uint64_t now_us);
  void abort(uint64_t now_us);
  void close_shutter(uint64_t now_us);

  void darken(uint64_t now_us);
  void follow_light(uint64_t now_us);
  void switch_light(bool on, uint32_t level_ppb);
  uint64_t trip_us() const;
  bool measuring() const { return busy_ && exposure_.lit && light_; }
  void sample(uint64_t due_us, uint64_t now_us);
  int32_t window_mean() const;

  void queue(Error error);
  Error next_error();

  void put(const char* text);
  void put_decimal(uint64_t number, uint8_t decimals, bool trim);

  Board& board_;
  const char* serial_;
  uint64_t power_up_us_;
  uint64_t heard_us_;

  char line_[kLongestLine + 1];
  size_t length_ = 0;
  bool unreadable_ = false;  // too long, or not ASCII

  Error errors_[kErrorQueue];
  uint8_t error_count_ = 0;

  bool busy_ = false;
  uint64_t light_edges_us_[2] = {kNever, kNever};  // of the running exposure, still to come
  Exposure exposure_ = {};
  uint32_t completed_ = 0;
  char last_id_[kLongestId + 1] = "";
  char next_id_[kLongestId + 1] = "";

  bool output_ = false;
  bool light_ = false;
  bool interlock_closed_ = true;
  bool tripped_ = false;
  Mode mode_ = Mode::kBulb;
  uint32_t level_ppb_ = kFull_ppb;
  uint32_t open_us_ = 1000000;
  uint32_t watchdog_us_ = 0;

  uint64_t next_sample_us_;
  uint16_t window_[kMonitorSamples] = {};  // the last 0.1 s
  uint8_t window_place_ = 0;
  uint32_t window_sum_ = 0;
  uint64_t lit_sum_ = 0;  // over the lit part of the running exposure
  uint32_t lit_count_ = 0;
  int32_t monitor_ = -1;  // over the last lit exposure; -1 if none yet, or too short to be read
};

}  // namespace gonio
