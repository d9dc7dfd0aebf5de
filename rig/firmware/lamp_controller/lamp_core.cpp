#include "lamp_core.h"

#include <string.h>

namespace gonio {
namespace {

constexpr uint64_t kPico = 1000000000000ULL;  // per second, or per unit of level
constexpr uint64_t kPicoPerMicro = 1000000ULL;

struct Range {
  uint64_t low_pico, high_pico;
};
constexpr Range kExposureRange = {10 * kPicoPerMicro, 600 * kPico};
constexpr Range kOpenRange = {1000 * kPicoPerMicro, 600 * kPico};
constexpr Range kWatchdogRange = {kPico / 10, 60 * kPico};
constexpr Range kLevelRange = {0, kPico};

constexpr const char* kErrorText[] = {
    "0,\"No error\"",           "-113,\"Undefined header\"",  "-222,\"Data out of range\"", "-284,\"Exposure running\"",
    "-240,\"Interlock open\"", "-241,\"Watchdog tripped\"", "-350,\"Queue overflow\"",
};
constexpr const char* kModeText[] = {"BULB", "WIDTH", "LAMP"};

bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_space(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }
char upper(char c) { return c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c; }

bool same_word(const char* a, const char* b) {
  while (*a && upper(*a) == upper(*b)) ++a, ++b;
  return upper(*a) == upper(*b);
}

bool is_id(const char* text) {
  const size_t length = strlen(text);
  if (length == 0 || length > kLongestId) return false;
  for (; *text; ++text) {
    const char c = upper(*text);
    if (!is_digit(c) && !(c >= 'A' && c <= 'Z') && c != '.' && c != '_' && c != '-') return false;
  }
  return true;
}

// A decimal number: digits, with their point and exponent still apart.
class Decimal {
 public:
  // False if the text is no decimal number.
  bool read(const char* text) {
    negative_ = *text == '-';
    if (*text == '+' || *text == '-') ++text;
    bool any = false;
    for (; is_digit(*text); ++text, any = true) take(*text, 0);
    if (*text == '.') {
      for (++text; is_digit(*text); ++text, any = true) take(*text, -1);
    }
    if (!any) return false;
    if (upper(*text) == 'E') {
      if (!read_exponent(text + 1, &text)) return false;
    }
    return *text == '\0';
  }

  // In units of 10^-12, rounded down; UINT64_MAX if it is more than that can hold or negative.
  uint64_t pico() const {
    if (digits_ == 0) return 0;
    if (negative_) return UINT64_MAX;
    uint64_t value = digits_;
    int32_t power = exponent_ + 12;
    for (; power > 0; --power) {
      if (value > UINT64_MAX / 10) return UINT64_MAX;
      value *= 10;
    }
    for (; power < 0 && value > 0; ++power) value /= 10;
    return value;
  }

 private:
  void take(char digit, int8_t shift) {
    if (digits_ < 100000000000000000ULL) {
      digits_ = digits_ * 10 + static_cast<uint64_t>(digit - '0');
      exponent_ += shift;
    } else {
      exponent_ += shift + 1;  // beyond 17 digits only the place counts
    }
  }

  bool read_exponent(const char* text, const char** end) {
    const bool minus = *text == '-';
    if (*text == '+' || *text == '-') ++text;
    if (!is_digit(*text)) return false;
    int32_t exponent = 0;
    for (; is_digit(*text); ++text) {
      if (exponent < 10000) exponent = exponent * 10 + (*text - '0');
    }
    exponent_ += minus ? -exponent : exponent;
    *end = text;
    return true;
  }

  uint64_t digits_ = 0;
  int32_t exponent_ = 0;
  bool negative_ = false;
};

bool read_number(const char* text, const Range& range, uint64_t* pico) {
  Decimal number;
  if (!number.read(text)) return false;
  *pico = number.pico();
  return *pico >= range.low_pico && *pico <= range.high_pico;
}

uint32_t microseconds(uint64_t pico) {
  return static_cast<uint32_t>((pico + kPicoPerMicro / 2) / kPicoPerMicro);
}

}  // namespace

const LampController::CommandRow LampController::kCommands[] = {
    {"*RST", &LampController::reset},           {"OUTP", &LampController::set_output},
    {"SOUR:LEV", &LampController::set_level},   {"SHUT:MODE", &LampController::set_mode},
    {"SHUT:OPEN", &LampController::set_open},   {"SHUT:ID", &LampController::set_id},
    {"SHUT:EXP", &LampController::expose},      {"SHUT:DARK", &LampController::expose_dark},
    {"SHUT:ABOR", &LampController::abort_command}, {"SYST:WDOG", &LampController::set_watchdog},
};

LampController::LampController(Board& board, const char* serial, uint64_t now_us)
    : board_(board), serial_(serial), power_up_us_(now_us), heard_us_(now_us), next_sample_us_(now_us + kSampleEvery_us) {}

// -- time

uint64_t LampController::trip_us() const {
  return watchdog_us_ > 0 && !tripped_ ? heard_us_ + watchdog_us_ : kNever;
}

uint64_t LampController::next_edge_us() const {
  const uint64_t end = busy_ ? exposure_.end_us : kNever;
  uint64_t first = end;
  for (uint64_t edge : light_edges_us_) first = edge < first ? edge : first;
  return first;
}

uint64_t LampController::next_due_us() const {
  uint64_t due = next_sample_us_;
  if (next_edge_us() < due) due = next_edge_us();
  if (trip_us() < due) due = trip_us();
  return due;
}

void LampController::poll(uint64_t now_us) {
  for (uint64_t due = next_due_us(); due <= now_us; due = next_due_us()) {
    if (trip_us() == due) {
      tripped_ = true;
      darken(due);
    } else if (light_edges_us_[0] == due) {
      light_edges_us_[0] = light_edges_us_[1];
      light_edges_us_[1] = kNever;
      follow_light(due);
    } else if (busy_ && exposure_.end_us == due) {
      complete(due);
    } else {
      sample(due, now_us);
    }
  }
}

void LampController::set_interlock(bool closed, uint64_t now_us) {
  poll(now_us);
  if (closed == interlock_closed_) return;
  interlock_closed_ = closed;
  if (!closed && (!busy_ || exposure_.lit)) darken(now_us);
}

// -- the line

void LampController::receive(char character, uint64_t now_us) {
  poll(now_us);
  if (character == '\n') {
    line_[length_] = '\0';
    obey(now_us);
    length_ = 0;
    unreadable_ = false;
  } else if (character != '\r') {
    if (length_ == kLongestLine || static_cast<unsigned char>(character) > 0x7e) {
      unreadable_ = true;
    } else {
      line_[length_++] = character == '\0' ? '\x01' : character;  // a NUL would end the line unseen
    }
  }
}

void LampController::obey(uint64_t now_us) {
  char* end = line_ + length_;
  while (end > line_ && is_space(end[-1])) *--end = '\0';
  char* header = line_;
  while (is_space(*header)) ++header;
  if (unreadable_) return queue(Error::kHeader);
  if (*header == '\0') return;
  char* argument = header;
  while (*argument && *argument != ' ') ++argument;
  if (*argument) *argument++ = '\0';
  while (is_space(*argument)) ++argument;

  if (*argument == '\0' && answer(header, now_us)) {
    heard_us_ = now_us;
    return;
  }
  Error error = Error::kHeader;
  for (const CommandRow& row : kCommands) {
    if (same_word(row.header, header)) error = (this->*row.run)(argument, now_us);
  }
  if (error != Error::kNone) queue(error);
  // What is no valid line, the watchdog did not hear.
  if (error != Error::kHeader && error != Error::kRange) heard_us_ = now_us;
}

bool LampController::answer(const char* header, uint64_t now_us) {
  const auto is = [header](const char* query) { return same_word(header, query); };
  if (is("*IDN?")) {
    put("gonio,lamp,");
    put(serial_);
    put(",");
    put(kFirmware);
  } else if (is("OUTP?")) {
    put(output_ ? "1" : "0");
  } else if (is("SOUR:LEV?")) {
    put_decimal(level_ppb_, 9, true);
  } else if (is("SHUT:MODE?")) {
    put(kModeText[static_cast<uint8_t>(mode_)]);
  } else if (is("SHUT:OPEN?")) {
    put_decimal(open_us_, 6, true);
  } else if (is("SHUT?")) {
    put(busy_ ? "BUSY," : "IDLE,");
    put_decimal(completed_, 0, false);
    put(",");
    put(last_id_);
  } else if (is("MEAS:MON?")) {
    const int32_t value = light_ ? window_mean() : monitor_;
    if (value < 0) {
      put("nan");
    } else {
      put_decimal(static_cast<uint32_t>(value), 4, true);
    }
  } else if (is("MEAS:TEMP?")) {
    const int16_t tenths = board_.temperature();
    if (tenths < 0) put("-");
    put_decimal(static_cast<uint32_t>(tenths < 0 ? -tenths : tenths), 1, false);
  } else if (is("INTL?")) {
    put(interlock_closed_ ? "1" : "0");
  } else if (is("SYST:WDOG?")) {
    put_decimal(watchdog_us_, 6, true);
  } else if (is("SYST:ERR?")) {
    put(kErrorText[static_cast<uint8_t>(next_error())]);
  } else if (is("SYST:UPT?")) {
    put_decimal((now_us - power_up_us_) / 1000, 3, false);
  } else {
    return false;
  }
  put("\n");
  return true;
}

void LampController::queue(Error error) {
  if (error_count_ < kErrorQueue) {
    errors_[error_count_++] = error;
  } else {
    errors_[kErrorQueue - 1] = Error::kOverflow;
  }
}

Error LampController::next_error() {
  if (error_count_ == 0) return Error::kNone;
  const Error oldest = errors_[0];
  --error_count_;
  memmove(errors_, errors_ + 1, error_count_ * sizeof errors_[0]);
  return oldest;
}

void LampController::put(const char* text) {
  for (; *text; ++text) board_.send(*text);
}

void LampController::put_decimal(uint64_t number, uint8_t decimals, bool trim) {
  char digits[24];
  char* first = digits + sizeof digits;
  *--first = '\0';
  for (uint8_t place = 0; number > 0 || place <= decimals; ++place) {
    if (place == decimals && decimals > 0) *--first = '.';
    *--first = static_cast<char>('0' + number % 10);
    number /= 10;
  }
  if (trim && decimals > 0) {
    char* last = digits + sizeof digits - 2;
    while (*last == '0') *last-- = '\0';
    if (*last == '.') *last = '\0';
  }
  put(first);
}

// -- commands

Error LampController::reset(const char* argument, uint64_t now_us) {
  if (*argument) return Error::kRange;
  darken(now_us);
  level_ppb_ = kFull_ppb;
  mode_ = Mode::kBulb;
  watchdog_us_ = 0;
  tripped_ = false;
  error_count_ = 0;
  return Error::kNone;
}

Error LampController::set_output(const char* argument, uint64_t now_us) {
  if (same_word(argument, "OFF")) {
    darken(now_us);
    return Error::kNone;
  }
  if (!same_word(argument, "ON")) return Error::kRange;
  if (!interlock_closed_) return Error::kInterlock;
  if (tripped_) return Error::kWatchdog;
  output_ = true;
  follow_light(now_us);
  return Error::kNone;
}

Error LampController::set_level(const char* argument, uint64_t now_us) {
  uint64_t pico;
  if (!read_number(argument, kLevelRange, &pico)) return Error::kRange;
  level_ppb_ = static_cast<uint32_t>((pico + 500) / 1000);
  follow_light(now_us);
  return Error::kNone;
}

Error LampController::set_mode(const char* argument, uint64_t) {
  for (uint8_t mode = 0; mode < 3; ++mode) {
    if (same_word(argument, kModeText[mode])) {
      mode_ = static_cast<Mode>(mode);
      return Error::kNone;
    }
  }
  return Error::kRange;
}

Error LampController::set_open(const char* argument, uint64_t) {
  uint64_t pico;
  if (!read_number(argument, kOpenRange, &pico)) return Error::kRange;
  open_us_ = microseconds(pico);
  return Error::kNone;
}

Error LampController::set_id(const char* argument, uint64_t) {
  if (!is_id(argument)) return Error::kRange;
  strcpy(next_id_, argument);
  strcpy(last_id_, argument);
  return Error::kNone;
}

Error LampController::set_watchdog(const char* argument, uint64_t) {
  uint64_t pico;
  if (!read_number(argument, {0, kWatchdogRange.high_pico}, &pico)) return Error::kRange;
  if (pico > 0 && pico < kWatchdogRange.low_pico) return Error::kRange;
  watchdog_us_ = microseconds(pico);
  tripped_ = false;
  return Error::kNone;
}

Error LampController::expose(const char* argument, uint64_t now_us) {
  return begin(argument, output_ || mode_ == Mode::kLamp, now_us);
}

Error LampController::expose_dark(const char* argument, uint64_t now_us) { return begin(argument, false, now_us); }

Error LampController::abort_command(const char* argument, uint64_t now_us) {
  if (*argument) return Error::kRange;
  abort(now_us);
  return Error::kNone;
}

// -- exposures

Error LampController::begin(const char* argument, bool lit, uint64_t now_us) {
  uint64_t pico;
  if (!read_number(argument, kExposureRange, &pico)) return Error::kRange;
  if (busy_) return Error::kRunning;
  if (tripped_) return Error::kWatchdog;
  if (lit && !interlock_closed_) return Error::kInterlock;
  const bool timed_by_lamp = mode_ == Mode::kLamp;
  const uint32_t exposure_us = microseconds(pico);
  if (timed_by_lamp && exposure_us > open_us_) return Error::kRange;  // the shutter would cut the light short
  exposure_.exposure_us = exposure_us;
  exposure_.open_us = timed_by_lamp ? open_us_ : exposure_us;
  exposure_.lit = lit;
  exposure_.level_ppb = level_ppb_;
  exposure_.mode = mode_;
  exposure_.shot = completed_ + 1;
  strcpy(exposure_.id, next_id_);
  next_id_[0] = '\0';
  exposure_.begin_us = now_us;
  exposure_.end_us = now_us + exposure_.open_us;
  const uint64_t light_begin_us = now_us + (exposure_.open_us - exposure_us) / 2;
  exposure_.light_begin_us = lit ? light_begin_us : exposure_.end_us;
  exposure_.light_end_us = lit ? light_begin_us + exposure_us : exposure_.end_us;
  if (lit && timed_by_lamp) {
    light_edges_us_[0] = exposure_.light_begin_us;
    light_edges_us_[1] = exposure_.light_end_us;
  }
  lit_sum_ = lit_count_ = 0;
  busy_ = true;
  // The lamp first: a dark exposure opens on a dark room.
  follow_light(now_us);
  board_.shutter(true);
  return Error::kNone;
}

void LampController::complete(uint64_t now_us) {
  close_shutter(now_us);
  ++completed_;
  if (!exposure_.lit) return;
  if (lit_count_ > 0) {
    monitor_ = static_cast<int32_t>((lit_sum_ + lit_count_ / 2) / lit_count_);
  } else {
    // Too short for a reading of its own; continuous light had been read just before.
    monitor_ = exposure_.mode == Mode::kLamp ? -1 : window_mean();
  }
}

void LampController::abort(uint64_t now_us) {
  if (busy_) close_shutter(now_us);
}

void LampController::close_shutter(uint64_t now_us) {
  board_.shutter(false);
  busy_ = false;
  light_edges_us_[0] = light_edges_us_[1] = kNever;
  follow_light(now_us);
}

// -- light

void LampController::darken(uint64_t now_us) {
  output_ = false;
  switch_light(false, 0);
  abort(now_us);
}

void LampController::follow_light(uint64_t now_us) {
  if (busy_) {
    const bool on = exposure_.lit && exposure_.light_begin_us <= now_us && now_us < exposure_.light_end_us;
    switch_light(on, exposure_.level_ppb);
  } else {
    switch_light(output_, level_ppb_);
  }
}

void LampController::switch_light(bool on, uint32_t level_ppb) {
  light_ = on;
  board_.light(on, level_ppb);
}

void LampController::sample(uint64_t due_us, uint64_t now_us) {
  next_sample_us_ = now_us > due_us + kSampleEvery_us ? now_us + 1 : due_us + kSampleEvery_us;
  if (next_edge_us() - due_us < kQuietBeforeEdge_us) return;
  const uint16_t reading = board_.photodiode();
  window_sum_ += reading;
  window_sum_ -= window_[window_place_];
  window_[window_place_] = reading;
  window_place_ = static_cast<uint8_t>((window_place_ + 1) % kMonitorSamples);
  if (measuring()) {
    lit_sum_ += reading;
    ++lit_count_;
  }
}

int32_t LampController::window_mean() const {
  return static_cast<int32_t>((window_sum_ + kMonitorSamples / 2) / kMonitorSamples);
}

}  // namespace gonio
