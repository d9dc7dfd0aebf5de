// The lamp controller on an Arduino: pins, clock and serial line around lamp_core.
//
// Wiring, calibration and what was measured where: README.md beside this file.

#include "lamp_core.h"

#ifdef __AVR__
#include <avr/wdt.h>
#endif

namespace {

// -- this board: adapt to yours

constexpr char kSerial[] = "0001";

constexpr uint8_t kLampEnablePin = 7;   // HIGH lets the LED driver drive; a pull-down keeps it dark in reset
constexpr uint8_t kLampLevelPin = 9;    // PWM, filtered, to the driver's dimming input
constexpr uint8_t kShutterPin = 8;      // to the camera's release through an optocoupler
constexpr uint8_t kInterlockPin = 2;    // loop to ground: LOW is closed, a broken wire is open
constexpr uint8_t kPhotodiodePin = A0;
constexpr uint8_t kTemperaturePin = A1;  // LM35, 10 mV per degree C

constexpr uint32_t kAdcFull = 1023;
constexpr uint32_t kAdcFull_mV = 5000;
constexpr uint32_t kPhotodiodeNominal = 700;  // reading at level 1 on the day of calibration

constexpr uint32_t kSpin_us = 1500;  // an edge this near is waited for: nothing else may delay it
constexpr uint32_t kPwmFull = 255;

// -- the board as the controller sees it

class ArduinoBoard final : public gonio::Board {
 public:
  void light(bool on, uint32_t level_ppb) override {
    const uint32_t duty = (level_ppb / 1000 * kPwmFull + 500000) / 1000000;
    analogWrite(kLampLevelPin, on ? static_cast<int>(duty) : 0);
    digitalWrite(kLampEnablePin, on && level_ppb > 0 ? HIGH : LOW);
  }

  void shutter(bool open) override { digitalWrite(kShutterPin, open ? HIGH : LOW); }

  uint16_t photodiode() override {
    return static_cast<uint16_t>(static_cast<uint32_t>(analogRead(kPhotodiodePin)) * 10000 / kPhotodiodeNominal);
  }

  int16_t temperature() override {
    return static_cast<int16_t>(static_cast<uint32_t>(analogRead(kTemperaturePin)) * kAdcFull_mV / kAdcFull);
  }

  void send(char character) override { Serial.write(character); }
};

// micros() starts again every 71 minutes; this does not.
uint64_t now_us() {
  static uint32_t last = 0, turns = 0;
  const uint32_t low = micros();
  if (low < last) ++turns;
  last = low;
  return static_cast<uint64_t>(turns) << 32 | low;
}

ArduinoBoard board;
gonio::LampController* controller;

bool interlock_closed() { return digitalRead(kInterlockPin) == LOW; }

}  // namespace

void setup() {
  digitalWrite(kLampEnablePin, LOW);
  digitalWrite(kShutterPin, LOW);
  pinMode(kLampEnablePin, OUTPUT);
  pinMode(kShutterPin, OUTPUT);
  pinMode(kLampLevelPin, OUTPUT);
  pinMode(kInterlockPin, INPUT_PULLUP);
  Serial.begin(115200);
  static gonio::LampController the_controller(board, kSerial, now_us());
  controller = &the_controller;
#ifdef __AVR__
  wdt_enable(WDTO_250MS);  // a hung program is reset, and a reset is dark
#endif
}

void loop() {
#ifdef __AVR__
  wdt_reset();
#endif
  controller->set_interlock(interlock_closed(), now_us());
  while (Serial.available() > 0) controller->receive(static_cast<char>(Serial.read()), now_us());

  const uint64_t edge = controller->next_edge_us();
  if (edge != gonio::kNever && edge < now_us() + kSpin_us) {
    while (now_us() < edge && interlock_closed()) {
    }
    controller->set_interlock(interlock_closed(), now_us());
  }
  controller->poll(now_us());
}
