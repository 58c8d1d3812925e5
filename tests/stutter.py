#!/usr/bin/env python3
"""stutter.py [--rounds N] [--run MS] [--stand MS] COMMAND...: runs the command over and over, stopped and continued at
random moments, as a busy machine would. Shows which tests assume that they are given time. Ends with the number of
rounds that failed, whose output it prints."""
import argparse
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
arguments.add_argument("command", nargs=argparse.REMAINDER)
options = arguments.parse_args()
if not options.command:
    arguments.error("which command?")

failed = 0
for number in range(1, options.rounds + 1):
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(options.command, stdout=output, stderr=subprocess.STDOUT)
        while process.poll() is None:
            time.sleep(random.expovariate(1000 / options.run))
            process.send_signal(signal.SIGSTOP)  # nothing, once it has ended
            time.sleep(random.expovariate(1000 / options.stand))
            process.send_signal(signal.SIGCONT)
        if process.returncode != 0:
            failed += 1
            output.seek(0)
            sys.stdout.write(output.read().decode(errors="replace"))
            print(f"round {number} failed with {process.returncode}", flush=True)
print(f"{failed} of {options.rounds} rounds failed")
sys.exit(failed != 0)
