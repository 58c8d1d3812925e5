#!/usr/bin/env python3
"""stutter.py [--rounds N] [--run MS] [--stand MS] [--busy N] COMMAND...: runs the command over and over, stopped and
continued at random moments with the programs it starts, as a busy machine would, and beside N loops that want a processor
each (with --stand 0: beside these alone). Shows which tests assume that they are given time. Ends with the number of
rounds that failed, whose output it prints."""
import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time

arguments = argparse.ArgumentParser(description=__doc__)
arguments.add_argument("--rounds", type=int, default=10)
arguments.add_argument("--run", type=float, default=5, help="mean time to let it run, in ms")
arguments.add_argument("--stand", type=float, default=20, help="mean time to keep it stopped, in ms")
arguments.add_argument("--busy", type=int, default=0, help="how many loops compete for the processors")
arguments.add_argument("command", nargs=argparse.REMAINDER)
options = arguments.parse_args()
if not options.command:
    arguments.error("which command?")


def stop_or_go(process, what):
    """The command and the programs it started."""
    if process.poll() is None:
        os.killpg(process.pid, what)


busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(options.busy)]


failed = 0
for number in range(1, options.rounds + 1):
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(options.command, stdout=output, stderr=subprocess.STDOUT, process_group=0)
        while process.poll() is None:
            time.sleep(random.expovariate(1000 / options.run))
            if options.stand == 0:
                continue
            stop_or_go(process, signal.SIGSTOP)
            time.sleep(random.expovariate(1000 / options.stand))
            stop_or_go(process, signal.SIGCONT)
        if process.returncode != 0:
            failed += 1
            output.seek(0)
            sys.stdout.write(output.read().decode(errors="replace"))
            print(f"round {number} failed with {process.returncode}", flush=True)
for one in busy:
    one.kill()
print(f"{failed} of {options.rounds} rounds failed")
sys.exit(failed != 0)
