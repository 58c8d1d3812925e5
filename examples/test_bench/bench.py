#!/usr/bin/env python3
"""A bench for a rocket motor that is not there: bench.py [--fault overpressure|dead|cold] [--rate HZ]

Makes pseudo terminals in the current folder, as the serial devices of test_bench.json: `daq` sends lines
"count,thrust,chamber,tank" (N, bar, bar), `heat` lines of four temperatures (Cel), 10 a second; `igniter`, `valve` and
`purge` take lines "0" and "1", and answer "ok". With igniter and valve on, the motor lights after 0.2 s.

Faults: overpressure (the chamber's pressure rises on and on, from 1 s after the ignition), dead (daq sends nothing any
more from then), cold (it does not light). What it does is on standard output.
"""
import argparse
import os
import select
import time
import tty


class Line:
    """A pseudo terminal with a name."""

    def __init__(self, name):
        self.master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        if os.path.islink(name):
            os.unlink(name)
        os.symlink(os.ttyname(slave), name)
        self.slave = slave  # kept, so that it stays while nobody else has it
        self.name = name
        self.got = b""

    def send(self, text):
        try:
            os.write(self.master, text.encode())
        except BlockingIOError:
            pass  # nobody reads

    def lines(self):
        try:
            self.got += os.read(self.master, 4096)
        except BlockingIOError:
            pass
        *whole, self.got = self.got.split(b"\n")
        return [line.decode() for line in whole]


class Motor:
    def __init__(self, fault):
        self.fault = fault
        self.igniter = self.valve = self.purge = False
        self.lit_since = None  # s
        self.asked_since = None
        self.chamber = self.thrust = 0.0
        self.tank = 80.0
        self.heat = [20.0, 20.0, 20.0, 20.0]

    def step(self, now, span):
        if self.igniter and self.valve and self.fault != "cold":
            self.asked_since = self.asked_since or now
            if now - self.asked_since > 0.2:
                self.lit_since = self.lit_since or now
        if not self.valve:
            self.lit_since = self.asked_since = None
        goal = 0.0
        if self.lit_since is not None:
            burning = now - self.lit_since
            goal = 40.0
            if self.fault == "overpressure" and burning > 1:
                goal = 40.0 + 60.0 * (burning - 1)
            self.tank = max(0.0, self.tank - 4.0 * span)
        self.chamber += (goal - self.chamber) * min(1.0, span / 0.05)
        self.thrust = 55.0 * self.chamber
        for i, most in enumerate((900.0, 400.0, 150.0, 25.0)):
            goal = most if self.lit_since is not None else 20.0
            self.heat[i] += (goal - self.heat[i]) * min(1.0, span / 2.0)

    def is_dead(self, now):
        return self.fault == "dead" and self.lit_since is not None and now - self.lit_since > 1


def main():
    options = argparse.ArgumentParser()
    options.add_argument("--fault", choices=["overpressure", "dead", "cold"])
    options.add_argument("--rate", type=float, default=500)
    chosen = options.parse_args()
    daq, heat = Line("daq"), Line("heat")
    relays = [Line(name) for name in ("igniter", "valve", "purge")]
    motor = Motor(chosen.fault)
    began = time.monotonic()
    count = heats = 0
    has_died = False
    print("the bench is there", flush=True)
    while True:
        next_at = began + (count + 1) / chosen.rate
        ready, _, _ = select.select([relay.master for relay in relays], [], [], max(0.0, next_at - time.monotonic()))
        for relay in relays:
            for line in relay.lines() if relay.master in ready else []:
                setattr(motor, relay.name, line == "1")
                relay.send("ok\n")
                print(f"{relay.name} {line}", flush=True)
        now = time.monotonic()
        while began + (count + 1) / chosen.rate <= now:
            count += 1
            at = count / chosen.rate
            motor.step(at, 1 / chosen.rate)
            has_died = has_died or motor.is_dead(at)
            if not has_died:
                daq.send(f"{count},{motor.thrust:.1f},{motor.chamber:.2f},{motor.tank:.2f}\n")
            if at * 10 >= heats + 1:
                heats += 1
                heat.send(",".join(f"{value:.1f}" for value in motor.heat) + "\n")


if __name__ == "__main__":
    main()
