// What the kernel says of a terminal's settings. In a file of its own: <asm/termbits.h> and <termios.h> do not go
// together.
#pragma once

struct TerminalSettings {
  unsigned input_speed = 0;
  unsigned output_speed = 0;
  unsigned control_flags = 0;
  unsigned local_flags = 0;
  bool is_exclusive = false;
};
TerminalSettings terminal_settings(int fd);

/// False where no program can set up a terminal, as in an emulator of another processor that does not know how
/// (qemu-user).
bool terminals_can_be_set_up();
