"""Writes the simulated flight that flight.csv holds: python3 flight.py >flight.csv"""

STEP, NOISE = 0.05, 0.8  # s, m
G, DRAG, THRUST = 9.81, 0.0009, 90.0  # m/s2, 1/m, m/s2

height = speed = 0.0
chance = 1
print("t,altitude [m],acceleration")
for i in range(int(160 / STEP)):
    t = i * STEP
    push = THRUST if 10 <= t < 14 else 0.0
    is_open = t > 14 and speed < 0  # the parachute
    drag = (0.05 if is_open else DRAG) * speed * abs(speed)
    felt = push - drag  # without gravity, as an accelerometer feels it
    if t < 10 or (t > 20 and height <= 0):
        felt, height, speed = G, 0.0, 0.0
    else:
        speed += (felt - G) * STEP
        height += speed * STEP
    chance = (chance * 1103515245 + 12345) % 2**31
    noise = NOISE * (chance / 2**30 - 1)
    dip = 400 if 14.6 <= t < 15.6 else 0  # the pressure near Mach 1
    print(f"{t:.2f},{height + noise - dip:.1f},{felt / G:.2f}")
