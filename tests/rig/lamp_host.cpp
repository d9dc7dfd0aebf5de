// The lamp controller's firmware on the host, with a clock that the tests turn and a photodiode that sees the
// lamp. Reads one order a line, answers what happened and then one line that begins with "=".
//
//   R <us> <hex>   these bytes arrive        P <us>   time passes until then
//   I <us> <0|1>   interlock opens, closes   D <0..2> scale of the photodiode
//   G <us>         a partial line is forgotten

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lamp_core.h"

namespace {

uint64_t now_us = 0;

class HostBoard final : public gonio::Board {
 public:
  void light(bool on, uint32_t level_ppb) override {
    if (on != on_) printf("light %" PRIu64 " %d %" PRIu32 "\n", now_us, on, level_ppb);
    on_ = on;
    level_ppb_ = on ? level_ppb : 0;
  }
  void shutter(bool open) override {
    printf("shutter %" PRIu64 " %d\n", now_us, open);
    closed = !open;
  }
  uint16_t photodiode() override { return static_cast<uint16_t>(level_ppb_ / 100000 * dimming); }
  int16_t temperature() override { return 315; }
  void send(char character) override { answer[length++] = character; }

  bool closed = false;
  double dimming = 1.0;
  char answer[1 << 16];
  size_t length = 0;

 private:
  bool on_ = false;
  uint32_t level_ppb_ = 0;
};

HostBoard board;
gonio::LampController controller(board, "S1", 0);
uint32_t completed = 0;

void tell_of_frames() {
  if (!board.closed) return;
  board.closed = false;
  const gonio::Exposure& shot = controller.exposure();
  const bool done = controller.completed() != completed;
  completed = controller.completed();
  printf("%s %" PRIu64 " %" PRIu32 " %" PRIu32 " %d %" PRIu32 " %d %" PRIu32 " %s\n", done ? "frame" : "aborted",
         now_us, shot.exposure_us, shot.open_us, shot.lit, shot.level_ppb, static_cast<int>(shot.mode), shot.shot,
         shot.id);
}

void pass_until(uint64_t time_us) {
  while (controller.next_due_us() <= time_us) {
    now_us = controller.next_due_us();
    controller.poll(now_us);
    tell_of_frames();
  }
  now_us = time_us;
}

}  // namespace

int main() {
  static char order[1 << 20];
  while (fgets(order, sizeof order, stdin)) {
    char* rest = order + 1;
    if (*order == 'D') {
      board.dimming = strtod(rest, nullptr);
    } else {
      pass_until(strtoull(rest, &rest, 10));
    }
    if (*order == 'I') {
      controller.set_interlock(atoi(rest) != 0, now_us);
    } else if (*order == 'G') {
      controller.forget_partial_line();
    } else if (*order == 'R') {
      unsigned byte;
      for (++rest; sscanf(rest, "%2x", &byte) == 1; rest += 2) {
        controller.receive(static_cast<char>(byte), now_us);
        tell_of_frames();
      }
    }
    tell_of_frames();
    printf("= ");
    for (size_t i = 0; i < board.length; ++i) printf("%02x", static_cast<unsigned char>(board.answer[i]));
    printf("\n");
    board.length = 0;
    fflush(stdout);
  }
  return 0;
}
