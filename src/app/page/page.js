"use strict";
// What the page shows. Texts come from devices, people and other programs: each goes in as text, none as markup.

(() => {
  const $ = (id) => document.getElementById(id);
  const root = document.documentElement;
  const mostRows = 200, mostEvents = 200, sparkSpan = 60e3;
  const values = new Map();    // by "topic|origin|path"
  const units = new Map();     // by topic: by path
  const outputs = new Map();   // the last change, by topic
  const disks = new Map();     // by path: the first size seen, and the last
  const pins = new Set();
  const happened = [];         // newest first
  let about = {parts: []}, status = null, may = [], isTold = false, leftOut = 0, isRecording = true, hasSparks = false;

  function make(name, text, properties = {}) {
    const made = Object.assign(document.createElement(name), properties);
    if (text !== undefined && text !== null) made.textContent = text;
    return made;
  }
  // Rows are kept from one drawing to the next, so that a button under a finger stays.
  function fill(body, rows) {
    const known = new Map([...body.children].map((row) => [row.dataset.key, row]));
    let at = body.firstElementChild;
    for (const {key, cells, className = "", build} of rows) {
      let row = known.get(key);
      if (!row) {
        row = make("tr");
        row.dataset.key = key;
        if (build) build(row); else for (const cell of cells) { void cell; row.append(make("td")); }
      }
      known.delete(key);
      if (row !== at) body.insertBefore(row, at); else at = at.nextElementSibling;
      if (row.className !== className) row.className = className;
      cells.forEach((cell, i) => {
        if (cell === undefined) return;
        const [text, style] = Array.isArray(cell) ? cell : [cell, ""];
        const to = row.children[i], said = text === null ? "" : String(text);
        if (to.textContent !== said) to.textContent = said;
        if (to.className !== style) to.className = style;
      });
    }
    for (const row of known.values()) row.remove();
  }

  const seconds = (ms) => {
    const s = Math.max(0, ms) / 1000;
    if (s < 10) return s.toFixed(1) + " s";
    if (s < 120) return Math.round(s) + " s";
    if (s < 7200) return Math.round(s / 60) + " min";
    return s < 172800 ? Math.round(s / 3600) + " h" : Math.round(s / 86400) + " d";
  };
  const rate = (hz) => (hz === null || hz === undefined ? "?" : String(+hz.toPrecision(hz < 10 ? 2 : 4)));
  const lostOf = (one) => one.missed + one.failed + one.unreadable - (one.failed_unreadable || 0) + (one.lost || 0) +
    (one.dropped || 0);
  const healthStyle = (health) => ({ok: "good", degraded: "warn", faulted: "bad"}[health] || "");
  // What publishes its changes alone may be silent.
  const isOfChanges = (topic) => topic === "rtdata/commands" || about.parts.some((one) => one.topic === topic && one.kind !== "sensor");
  const sensorOf = (origin) => status && status.sensors.find((one) => one.name === origin);

  // ---- values

  function valueOf(topic, origin, path) {
    const key = topic + "|" + origin + "|" + path;
    if (!values.has(key)) values.set(key, {key, topic, origin, path, spark: [], last: null, at: -Infinity, text: null});
    return values.get(key);
  }
  const unitOf = (topic, path) => (units.get(topic) || {})[path] || "";

  function takeStep(line) {
    const time = line.time / 1e6;
    for (const [path, numbers] of Object.entries(line.data)) {
      const value = valueOf(line.topic, line.origin, path);
      value.at = Math.max(value.at, line.until / 1e6);
      if (numbers.count === 0) {
        value.last = null;
        Charts.step(line.topic, line.origin, path, unitOf(line.topic, path), time, numbers);
        continue;
      }
      value.last = numbers.last;
      const bucket = Math.floor(time / 1000) * 1000, spark = value.spark;
      if (spark.length && spark[spark.length - 1].time === bucket) spark[spark.length - 1].mean = numbers.mean;
      else spark.push({time: bucket, mean: numbers.mean});
      if (spark.length > 61) spark.shift();
      Charts.step(line.topic, line.origin, path, unitOf(line.topic, path), time, numbers);
    }
  }

  // The end of the data: now, or the end of a recording that is not running.
  const end = () => (isRecording ? Server.now() : about.run && about.run.ended);

  // The last minute from the recording; what came live stays.
  async function fillSparks() {
    const until = end(), topics = [...new Set(status.sensors.map((one) => one.topic))];
    for (let at = 0; at < topics.length; at += 16) {
      const asked = Object.fromEntries(topics.slice(at, at + 16).map((topic) => [topic, []]));
      let answer;
      try { answer = await Server.history({topics: asked, from: until - sparkSpan, until: until + 1000, step: 1000, marks: at === 0}); } catch { return; }
      if (answer.error) return;
      if (answer.run) Charts.told.run(answer.run);
      for (const gap of answer.gaps) Charts.addGap(gap);
      for (const event of answer.marks) takeEvent(event, true);
      for (const series of answer.series) {
        const value = valueOf(series.topic, series.origin, series.path), first = value.spark.length ? value.spark[0].time : Infinity;
        if (!units.has(series.topic)) units.set(series.topic, {});
        units.get(series.topic)[series.path] = series.unit;
        const before = series.time.map((time, i) => ({time, mean: series.mean[i]})).filter((one) => one.time < first);
        value.spark = before.concat(value.spark).slice(-61);
        if (before.length && value.at === -Infinity) {
          value.at = before[before.length - 1].time + 1000;
          value.last = before[before.length - 1].mean;
        }
      }
    }
    drawValues();
  }

  function drawSpark(canvas, value, until) {
    const scale = devicePixelRatio || 1, width = 90 * scale, height = 20 * scale;
    if (canvas.width !== width) { canvas.width = width; canvas.height = height; }
    const to = canvas.getContext("2d"), all = value.spark.filter((one) => one.time > until - sparkSpan && Number.isFinite(one.mean));
    to.clearRect(0, 0, width, height);
    if (all.length < 2) return;
    let least = Infinity, most = -Infinity;
    for (const one of all) { least = Math.min(least, one.mean); most = Math.max(most, one.mean); }
    const height_of = (mean) => (most > least ? height - 2 - (mean / 2 - least / 2) / (most / 2 - least / 2) * (height - 4) : height / 2);
    to.strokeStyle = getComputedStyle(canvas).color;
    to.lineWidth = scale;
    to.beginPath();
    let before = null;
    for (const one of all) {
      const x = (one.time - until + sparkSpan) / sparkSpan * width, y = height_of(one.mean);
      const isGap = before && Charts.gapsOf(value.topic, value.origin).some((gap) => gap.last > before.time && gap.first < one.time);
      before && !isGap ? to.lineTo(x, y) : to.moveTo(x, y);
      before = one;
    }
    to.stroke();
  }

  function drawValues() {
    const now = end();
    const wanted = $("filter").value.trim().toLowerCase();
    // A sensor without numbers has a row with its text.
    const withNumbers = new Set();
    for (const one of values.values()) if (one.path !== "") withNumbers.add(one.origin);
    if (status)
      for (const sensor of status.sensors)
        if (sensor.value !== null && !withNumbers.has(sensor.name)) valueOf(sensor.topic, sensor.name, "").text = sensor.value;
    let all = [...values.values()].filter((one) => one.path !== "" || !withNumbers.has(one.origin));
    all = all.filter((one) => !wanted || pins.has(one.key) || (one.topic + "." + one.path + " " + one.origin).toLowerCase().includes(wanted));
    all.sort((a, b) => pins.has(b.key) - pins.has(a.key) || a.key.localeCompare(b.key));
    $("more").textContent = all.length > mostRows ? `${all.length - mostRows} more: filter them` : "";
    all = all.slice(0, mostRows);
    const rows = all.map((value) => {
      const sensor = sensorOf(value.origin);
      const age = now === undefined ? undefined : now - value.at;
      const wantedHz = sensor && sensor.wanted_hz;
      const isGone = isTold && status && !sensor && !isOfChanges(value.topic) && !(age <= 2000);
      const isStale = isGone || !isOfChanges(value.topic) && (Number.isFinite(age) && isRecording && age > Math.max(2000, wantedHz ? 3000 / wantedHz : 5000));
      const alarm = alarmOf(value.topic, value.path);
      const late = sensor && sensor.lateness_ns;
      return {
        key: value.key, className: isStale ? "stale" : "",
        build: (row) => {
          for (let i = 0; i < 8; ++i) row.append(make("td"));
          const name = value.topic + (value.path ? "." + value.path : "");
          const pin = make("button", "", {type: "button"});
          pin.onclick = () => { pins.has(value.key) ? pins.delete(value.key) : pins.add(value.key); keepLayout(); drawValues(); };
          pin.setAttribute("aria-label", "Pin " + name);
          row.children[0].append(pin);
          const field = make(value.path ? "button" : "span", name, {className: "field"});
          if (value.path) { field.type = "button"; field.title = "Show or hide its curve"; field.onclick = () => Charts.toggle(value.topic, value.path); }
          row.children[1].append(field);
          row.children[7].className = "wide";
          row.children[7].append(make("canvas", null, {className: "spark"}));
        },
        cells: [undefined, undefined,
          [value.path ? Charts.valueText(value.last) : value.text, (value.path ? "number " : "") + alarm],
          unitOf(value.topic, value.path),
          [isGone ? "gone" : Number.isFinite(age) ? seconds(age) : "", "number"],
          [sensor ? rate(sensor.reached_hz) + (wantedHz ? " of " + rate(wantedHz) : "") + " Hz" : "", "number"],
          [late ? (late.p99 / 1e6).toFixed(late.p99 < 1e6 ? 2 : 1) + " ms" : "", "number"], undefined],
        value,
      };
    });
    const body = $("values").tBodies[0];
    fill(body, rows);
    for (const row of body.rows) {
      const value = values.get(row.dataset.key);
      const pin = row.children[0].firstChild, isPinned = pins.has(value.key);
      if (pin.textContent !== (isPinned ? "★" : "☆")) { pin.textContent = isPinned ? "★" : "☆"; pin.setAttribute("aria-pressed", isPinned); }
      if (now !== undefined) drawSpark(row.children[7].firstChild, value, now);
    }
  }

  // ---- parts

  const partsOf = (kind) => about.parts.filter((one) => one.kind === kind);
  function alarmOf(topic, path) {
    let worst = "";
    for (const limit of partsOf("limit")) {
      if (limit.item.on !== topic || (limit.item.field && limit.item.field !== path)) continue;
      const sensor = sensorOf(limit.name);
      if (!sensor || !sensor.alarm || !sensor.alarm.active) continue;
      worst = /_/.test(sensor.alarm.alarm) ? "bad" : worst || "warn";
    }
    return worst;
  }

  function drawMachines() {
    const all = partsOf("machine");
    $("machines-section").hidden = all.length === 0;
    fill($("machines").tBodies[0], all.map((machine) => {
      const sensor = sensorOf(machine.name);
      const state = sensor && sensor.state;
      const waits = (machine.item.transitions || []).filter((one) => one.from === state).map((one) => {
        const what = [one.event && "event " + one.event, one.when && "when " + one.when + (one.for ? " for " + one.for : ""), one.after && "after " + one.after];
        return what.filter(Boolean).join(", ") + " to " + one.to;
      });
      return {key: machine.name, cells: [machine.name, state || "?", sensor && sensor.in_state_s !== null ? seconds(sensor.in_state_s * 1000) : "",
                                         waits.join("; ") || (state ? "nothing" : "")]};
    }));
  }

  function drawOutputs() {
    const all = partsOf("output");
    $("outputs-section").hidden = all.length === 0;
    fill($("outputs").tBodies[0], all.map((output) => {
      const change = outputs.get(output.topic), safe = output.item.safe === undefined ? 0 : output.item.safe;
      if (!change) {
        const sensor = sensorOf(output.name);
        return {key: output.name, cells: [output.name, "", sensor ? sensor.value : "?", safe, "", "", ""]};
      }
      const done = change.done === null || change.done === undefined ? "not set" : change.done;
      return {key: output.name, cells: [output.name, Charts.valueText(change.asked), [typeof done === "number" ? Charts.valueText(done) : done, done === change.asked ? "" : "warn"],
                                        safe, change.armed ? ["armed", "warn"] : "no", change.by, change.why || change.cause]};
    }));
  }

  function drawHealth() {
    if (!status) return;
    fill($("sensors").tBodies[0], status.sensors.map((one) => ({
      key: one.name,
      cells: [one.name, one.running ? [one.health.state, healthStyle(one.health.state)] : "stopped",
              rate(one.reached_hz) + (one.wanted_hz ? " of " + rate(one.wanted_hz) : "") + " Hz",
              [lostOf(one) + (one.outages ? `, ${one.outages} outages` : ""), lostOf(one) + one.outages > 0 ? "warn" : ""], one.health.reason],
    })));
    fill($("sinks").tBodies[0], status.sinks.map((one) => ({
      key: one.name,
      cells: [one.name, [one.health.state, healthStyle(one.health.state)], one.stored, one.queued, [one.dropped, one.dropped ? "bad" : ""],
              one.backlog ? `${Math.round(one.backlog.bytes / 1024)} KiB, ${seconds(one.backlog.age_s * 1000)}` : "", one.health.reason],
    })));
    fill($("loops").tBodies[0], status.loops.map((one) => ({
      key: one.name,
      cells: [(one.tier ? "tier " : "") + one.name, one.load_percent === null ? "?" : one.load_percent.toFixed(1) + " %",
              one.lateness_ns ? (one.lateness_ns.p99 / 1e6).toFixed(2) + " ms" : "",
              [[one.hangs_in ? "hangs in " + one.hangs_in : "", ...one.warnings].filter(Boolean).join("; "), one.hangs_in ? "bad" : "warn"]],
    })));
  }

  function drawTop() {
    const silence = Server.silence(), isSilent = silence > 2000;
    $("top").classList.toggle("silent", isSilent);
    const said = !isTold ? "connecting" : isSilent ? "no data for " + seconds(silence) : isRecording ? "live" : "recording (not running)";
    if ($("connection").textContent !== said) $("connection").textContent = said;
    $("left-out").textContent = leftOut ? leftOut + " parts of the stream left out" : "";
    const now = Server.now();
    if (now !== undefined) {
      const known = Server.accuracy();
      $("utc").textContent = Charts.timeText(now).slice(0, 19) + " UTC " + (known === null ? "(accuracy not known)" : "± " + (known * 1000).toPrecision(2) + " ms");
    }
    if (!status) return;
    $("name").textContent = status.instance.name;
    document.title = status.instance.name + " – rt-data";
    $("since").textContent = (status.sinks.some((one) => one.path || isRecording) ? "recording since " : "running since ") + status.instance.started.slice(0, 19).replace("T", " ");
    const total = status.total, lost = lostOf(total);
    $("lost").textContent = "lost since the start: " + lost + (total.outages ? ` and ${total.outages} outages` : "");
    const notKnown = about.not_known || [];  // of a run that was not closed
    if (notKnown.length) {
      $("lost").textContent += ", as far as is known";
      $("lost").title = "not known: " + notKnown.join("; ");
    }
    $("lost").className = lost + total.outages > 0 || notKnown.length ? "bad" : "good";
    const rank = ["low_low", "high_high", "low", "high", "unknown"];
    const alarms = status.sensors.filter((one) => one.alarm && one.alarm.active).sort((a, b) => rank.indexOf(a.alarm.alarm) - rank.indexOf(b.alarm.alarm));
    const alarm = alarms.length ? `alarm: ${alarms[0].name} ${alarms[0].alarm.alarm}` + (alarms.length > 1 ? ` and ${alarms.length - 1} more` : "") : "";
    if ($("alarm").textContent !== alarm) $("alarm").textContent = alarm;
    $("alarm").className = alarms.length && /_/.test(alarms[0].alarm.alarm) ? "bad" : "warn";
  }

  function takeMachine(machine) {
    let least = Infinity;
    for (const disk of machine.disks) {
      const known = disks.get(disk.path);
      if (!known || disk.bytes < known.bytes) disks.set(disk.path, {bytes: disk.bytes, at: machine.now});
      const first = disks.get(disk.path), perMs = (disk.bytes - first.bytes) / (machine.now - first.at);
      if (machine.now - first.at > 4000 && perMs > 0) least = Math.min(least, disk.free / perMs);
    }
    const free = Math.min(...machine.disks.map((disk) => disk.free));
    $("disk").textContent = machine.disks.length === 0 ? "" :
      "disk left: " + (free / 2 ** 30).toFixed(1) + " GiB" + (least < Infinity ? ", " + (least > 36000e3 ? Math.round(least / 3600e3) : (least / 3600e3).toFixed(1)) + " h" : "");
  }

  // ---- what happened

  function addHappened(time, text) {
    happened.unshift({time, text});
    happened.length = Math.min(happened.length, mostEvents);
    const list = $("events");
    list.prepend(make("li", Charts.timeText(time) + " " + text));
    while (list.children.length > mostEvents) list.lastElementChild.remove();
  }
  const known = new Set();
  function takeEvent(event, isPast = false) {
    const key = event.topic + "|" + event.origin + "|" + event.sequence + "|" + event.time;
    if (known.has(key)) return;
    known.add(key);
    const data = event.data, time = event.time / 1e6;
    let text = "";
    if (event.topic === "$rtdata/gaps") {
      const gap = {topic: data.topic, origin: data.name, kind: data.kind, reason: data.reason, first: data.first / 1e6, last: data.last / 1e6, count: data.count};
      Charts.addGap(gap);
      addHappened(time, `gap of ${data.name}: ${Charts.gapText(gap)}`);
      return;
    }
    if (event.topic === "$rtdata/health") text = `${data.kind} ${data.name} is ${data.state}` + (data.reason ? ": " + data.reason : "");
    else if ("command" in data) text = `${data.command} by ${data.by}` + (data.done ? "" : " refused: " + data.outcome);
    else if ("from" in data && "to" in data) text = `${event.origin}: ${data.from} to ${data.to} (${data.cause})`;
    else if ("alarm" in data) text = `${event.origin}: ${data.alarm}` + (data.acknowledged ? "" : ", not acknowledged");
    else if ("asked" in data) {
      if (!isPast || !outputs.has(event.topic)) outputs.set(event.topic, data);
      text = `${event.origin}: asked ${data.asked}, ${data.cause} by ${data.by}` + (data.why ? ": " + data.why : "");
    } else return;
    Charts.addMark({time, text});
    if (!isPast) addHappened(time, text);
  }

  // ---- commands

  async function command(words) {
    $("answer").textContent = "…";
    try {
      const answer = await Server.command(words, $("who").value);
      $("answer").textContent = words.join(" ") + ": " + (answer.done || "refused: " + (answer.refused || answer.error || answer.ended));
      $("answer").className = answer.done ? "good" : "bad";
    } catch (error) {
      $("answer").textContent = "not sent: " + error.message;
      $("answer").className = "bad";
    }
  }
  function choice(label, names) {
    const made = make("label", label + " "), select = made.appendChild(make("select"));
    for (const name of names) select.append(make("option", name, {value: name}));
    return [made, select];
  }
  function form(title, parts, words) {
    const made = make("form");
    made.setAttribute("aria-label", title);
    made.append(...parts, make("button", title));
    made.onsubmit = (event) => { event.preventDefault(); command(words()); };
    $("commands").append(made);
  }
  // What moves something is pressed for a second and a half.
  function holdButton(text, act) {
    const button = make("button", text + " (hold)", {type: "button", className: "hold"});
    const shown = button.appendChild(make("progress", null, {max: 1500, value: 0}));
    let since = null;
    const turn = () => {
      if (since === null) return;
      shown.value = performance.now() - since;
      if (shown.value >= 1500) { stop(); act(); } else requestAnimationFrame(turn);
    };
    const begin = () => { if (since === null) { since = performance.now(); turn(); } };
    const stop = () => { since = null; shown.value = 0; };
    button.onpointerdown = begin;
    button.onpointerup = button.onpointerleave = button.onpointercancel = button.onblur = stop;
    button.onkeydown = (event) => { if (event.key === " " || event.key === "Enter") { event.preventDefault(); begin(); } };
    button.onkeyup = stop;
    return button;
  }
  let madeFor = "";
  function makeCommands() {
    const made = JSON.stringify([may, about.parts]);
    if (made === madeFor) return;
    madeFor = made;
    $("commands-section").hidden = may.length === 0;
    $("commands").replaceChildren();
    const names = (kind) => partsOf(kind).map((one) => one.name);
    if (may.includes("note")) {
      const label = make("label", "Note "), input = label.appendChild(make("input", null, {maxLength: 200, required: true}));
      form("Note", [label], () => { const words = ["note", ...input.value.trim().split(/\s+/)]; input.value = ""; return words; });
    }
    if (may.includes("ack") && names("limit").length) {
      const [label, select] = choice("Alarm", names("limit"));
      form("Acknowledge", [label], () => ["ack", select.value]);
    }
    if (may.includes("event"))
      for (const machine of partsOf("machine")) {
        const events = [...new Set((machine.item.transitions || []).map((one) => one.event).filter(Boolean))];
        if (!events.length) continue;
        const [label, select] = choice("Event of " + machine.name, events);
        form("Give", [label], () => ["event", machine.name, select.value]);
      }
    for (const output of partsOf("output")) {
      if (may.includes("set") && !output.item.on) {
        const label = make("label", "Set " + output.name + " "), input = label.appendChild(make("input", null, {required: true, size: 6}));
        form("Set", [label], () => ["set", output.name, input.value.trim()]);
      }
      if (may.includes("arm")) $("commands").append(holdButton("Arm " + output.name, () => command(["arm", output.name])));
      if (may.includes("disarm")) form("Disarm " + output.name, [], () => ["disarm", output.name]);
    }
    const sensors = about.parts.filter((one) => one.kind === "sensor").map((one) => one.name);
    if (sensors.length)
      for (const [word, title] of [["start", "Start"], ["stop", "Stop"]])
        if (may.includes(word)) {
          const [label, select] = choice("Sensor", sensors);
          form(title, [label], () => [word, select.value]);
        }
  }

  // ---- the layout, which is in the address

  const ranges = [["10 s", 10e3], ["1 min", 60e3], ["10 min", 600e3], ["1 h", 3600e3], ["6 h", 6 * 3600e3], ["1 d", 86400e3], ["all", Infinity]];
  function keepLayout() {
    const layout = new URLSearchParams();
    layout.set("range", $("range").value);
    for (const chart of Charts.charts) layout.append("chart", chart.fields.map((one) => one.topic + "." + one.path).join(","));
    for (const pin of pins) layout.append("pin", pin);
    if ($("filter").value) layout.set("filter", $("filter").value);
    if ($("wall").checked) layout.set("view", "wall");
    if (root.dataset.theme) layout.set("theme", root.dataset.theme);
    history.replaceState(null, "", "#" + layout.toString());
  }
  let wantedCharts = [];
  function takeLayout() {
    const layout = new URLSearchParams(location.hash.slice(1));
    $("range").value = ranges.some(([name]) => name === layout.get("range")) ? layout.get("range") : "1 min";
    $("filter").value = layout.get("filter") || "";
    $("wall").checked = layout.get("view") === "wall";
    root.classList.toggle("wall", $("wall").checked);
    if (["dark", "light"].includes(layout.get("theme"))) root.dataset.theme = layout.get("theme");
    for (const pin of layout.getAll("pin")) pins.add(pin);
    wantedCharts = layout.getAll("chart").map((one) => one.split(","));
  }
  // Topics and fields may both have points in their names: it is known which once they are heard.
  function fieldOf(name) {
    for (const [topic, paths] of units)
      for (const path of Object.keys(paths)) if (name === topic + "." + path) return {topic, path};
    return null;
  }
  function openCharts() {
    wantedCharts = wantedCharts.filter((names) => {
      const fields = names.map(fieldOf);
      if (fields.some((one) => !one)) return true;
      Charts.open(fields, false);
      return false;
    });
    if (!isFirstOpened && wantedCharts.length === 0 && Charts.charts.length === 0) {
      const all = [...values.values()].filter((one) => one.path && one.last !== null && one.spark.length > 0 && !isOfChanges(one.topic));
      if (!all.length) return;
      const first = all.reduce((best, one) => (one.spark.length > best.spark.length ? one : best));
      Charts.open([{topic: first.topic, path: first.path}], false);
    }
    isFirstOpened = isFirstOpened || Charts.charts.length > 0;
  }
  let isFirstOpened = false;

  // ---- what comes

  Server.on("page", (page) => { may = page.commands; isTold = true; $("ask-token").hidden = true; makeCommands(); });
  Server.on("about", (told) => {
    about = told;
    isRecording = told.recording !== false;
    Charts.setLimits(partsOf("limit").map((one) => ({topic: one.item.on, path: one.item.field, low_low: one.item.low_low, low: one.item.low,
                                                      high: one.item.high, high_high: one.item.high_high})));
    if (told.run) { Charts.setRun(told.run.started, told.run.ended === null || isRecording ? undefined : told.run.ended); if (told.run.clock) Server.setClock(told.run.clock); }
    if (told.fields) for (const [topic, paths] of Object.entries(told.fields)) units.set(topic, paths);
    makeCommands();
    drawMachines();
  });
  Server.on("units", (told, line) => {
    units.set(line.of, told);
    for (const value of [...values.values()])  // of fields that it has no more
      if (value.topic === line.of && value.path !== "" && !(value.path in told)) values.delete(value.key);
  });
  Server.on("error", (why) => { $("failed").textContent = why; });
  Server.on("status", (told) => {
    $("failed").textContent = told.error || "";
    if (told.error) return;  // what was known stays
    status = told;
    drawTop();
    drawHealth();
    drawMachines();
    drawOutputs();
  });
  Server.on("machine", takeMachine);
  Server.on("data", (_, line) => { line.until !== undefined ? takeStep(line) : takeEvent(line); });
  Server.on("left_out", (count) => { leftOut += count; Charts.forget(); Charts.fillAll(); });
  Server.on("break", (isOther) => {
    hasSparks = false;
    Charts.forget();
    if (isOther) {
      for (const one of [values, units, outputs, disks, known]) one.clear();
      status = null;
      Charts.forgetRun();
      drawValues();
    }
    Charts.fillAll();
  });
  Server.on("ended", () => { $("connection").textContent = "the run has ended"; });
  Server.on("refused", (why) => { $("ask-token").hidden = false; $("token-error").textContent = why; $("token").focus(); $("connection").textContent = "no access"; });
  Server.on("turn", () => {
    if (!hasSparks && status && end() !== undefined) { hasSparks = true; fillSparks(); }
    openCharts(); Charts.turn();
  });
  Charts.told.run = (run) => {
    $("run").textContent = "run " + run.number + (run.notes ? ": " + run.notes : "");
    if (!isRecording || Server.now() === undefined) { if (run.clock) Server.setClock(run.clock); }
  };
  Charts.told.mark = (event) => takeEvent(event, true);
  Charts.told.paused = (isPaused) => { $("pause").textContent = isPaused ? "Go on" : "Pause"; $("pause").setAttribute("aria-pressed", isPaused); };
  Charts.told.changed = keepLayout;
  Charts.told.history = (text, style) => { $("history").textContent = text; $("history").className = style; };
  Charts.told.unitOf = unitOf;

  // ---- what people do

  for (const [name] of ranges) $("range").append(make("option", name, {value: name}));
  const setRange = () => { Charts.setRange(ranges.find(([name]) => name === $("range").value)[1]); };
  $("range").onchange = () => { setRange(); keepLayout(); };
  $("pause").onclick = () => Charts.setPaused(!Charts.isPaused());
  $("filter").oninput = () => { drawValues(); keepLayout(); };
  $("wall").onchange = () => { root.classList.toggle("wall", $("wall").checked); keepLayout(); for (const chart of Charts.charts) chart.dygraph && chart.dygraph.resize(); };
  $("theme").onclick = () => {
    const isDark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = isDark ? "light" : "dark";
    keepLayout();
    Charts.drawAll();
  };
  function save(name, blob) {
    const link = make("a", null, {href: URL.createObjectURL(blob), download: name});
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10e3);
  }
  $("csv").onclick = () => Charts.charts.forEach((chart, i) => save(`chart-${i + 1}.csv`, new Blob([chart.csv()], {type: "text/csv"})));
  $("picture").onclick = () => Charts.charts.forEach((chart, i) => chart.picture().toBlob((blob) => save(`chart-${i + 1}.png`, blob)));
  $("lost").onclick = async () => {
    if (status)
      fill($("lost-of").tBodies[0], status.sensors.filter((one) => lostOf(one) + one.outages > 0).map((one) => ({
        key: one.name, cells: [one.name, one.missed, one.failed, one.unreadable, one.lost === null ? "not known" : one.lost, one.outages]})));
    const topics = {};
    if (status) for (const one of status.sensors) if (lostOf(one) + one.outages > 0 && Object.keys(topics).length < 64) topics[one.topic] = ["-"];
    // What still goes on is no gap of the recording yet.
    const ongoing = status ? status.sensors.filter((one) => one.health.state !== "ok" && lostOf(one) + one.outages > 0) : [];
    const show = () => fill($("lost-when").tBodies[0], ongoing.map((one) => ({key: "now " + one.name, cells: ["until now", one.name, one.health.state, "", one.health.reason]}))
      .concat(Charts.allGaps().sort((a, b) => b.first - a.first).slice(0, 300).map((gap, i) => ({
        key: String(i), cells: [Charts.timeText(gap.first), gap.origin, gap.kind, gap.count, gap.reason]}))));
    show();
    $("losses").showModal();
    const now = Server.now() || (about.run && about.run.ended), start = about.run ? about.run.started : status ? Date.parse(status.instance.started) - 60e3 : now - 3600e3;
    if (!now || !Object.keys(topics).length) return;
    const step = Math.max(60e3, Math.ceil((now - start) / 1000 / 60e3) * 60e3);
    const answer = await Server.history({topics, from: start, until: now, step, marks: false});
    for (const gap of answer.gaps || []) Charts.addGap(gap);
    show();
  };
  $("ask-token").onsubmit = (event) => { event.preventDefault(); Server.setToken($("token").value); Server.run(); };
  $("who").value = localStorage.getItem("rtdata-who") || "";
  $("who").onchange = () => localStorage.setItem("rtdata-who", $("who").value);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || /^(INPUT|SELECT|BUTTON|TEXTAREA)$/.test(event.target.tagName)) return;
    const at = ranges.findIndex(([name]) => name === $("range").value);
    const choose = (i) => { $("range").value = ranges[Math.min(ranges.length - 1, Math.max(0, i))][0]; setRange(); keepLayout(); };
    if (event.key === " ") Charts.setPaused(!Charts.isPaused());
    else if (event.key === "/") $("filter").focus();
    else if (event.key === "+") choose(at - 1);
    else if (event.key === "-") choose(at + 1);
    else if (event.key === "Escape") Charts.setPaused(false);
    else return;
    event.preventDefault();
  });
  addEventListener("hashchange", () => { Server.takeToken(); takeLayout(); setRange(); drawValues(); });

  Server.takeToken();
  takeLayout();
  setRange();
  setInterval(() => { drawTop(); if (!document.hidden) drawValues(); }, 500);
  if (Server.hasToken()) Server.run();
  else { $("ask-token").hidden = false; $("connection").textContent = "no access"; }
})();
