"use strict";
// Curves: the recording's steps, and behind them what comes live. Each point is [least, mean, most] of a step.

// What is drawn beside it is the page's own, as text; this one would make markup of names.
Dygraph.PLUGINS = Dygraph.PLUGINS.filter((one) => one !== Dygraph.Plugins.Legend);

const Charts = (() => {
  const liveStep = 250;
  const mostFine = 4 * 60 * 20;  // steps kept of what comes live: 20 minutes
  const colours = ["#1f77b4", "#d95f02", "#1b9e77", "#c51b7d", "#7a5fd0", "#8a6d00"];
  const steps = [1, 2, 5, 10, 20, 50, 100, 250, 500, 1e3, 2e3, 5e3, 10e3, 15e3, 30e3, 60e3, 120e3, 300e3, 600e3, 1800e3, 3600e3, 7200e3,
                 14400e3, 86400e3];
  const charts = [];
  const gaps = new Map();  // by "topic|origin": those that are known
  const marks = [];
  let range = 60e3, isPaused = false, view = null, limits = [], runStart, runEnd;
  let isDrawing = false;

  const keyOf = (topic, origin) => topic + "|" + origin;
  const span = () => (range === Infinity ? Math.max(10e3, (end() || 0) - (runStart || 0)) : range);
  const end = () => runEnd !== undefined ? runEnd : Server.now();
  // From when until when is shown.
  function shown() {
    if (view) return view;
    const until = end();
    return until === undefined ? null : {from: until - span(), until};
  }
  function stepOf(window) {
    const wanted = (window.until - window.from) / 500;
    const least = !view && runEnd === undefined ? liveStep : window.until - window.from > 60e3 ? 1e3 : 1;
    return steps.find((one) => one >= wanted && one >= least) || steps[steps.length - 1];
  }

  function addGap(gap) {
    const key = keyOf(gap.topic, gap.origin);
    if (!gaps.has(key)) gaps.set(key, []);
    const known = gaps.get(key);
    const same = known.findIndex((one) => Math.abs(one.first - gap.first) < 1 && one.kind === gap.kind);  // perhaps it goes on
    if (same >= 0) {
      if (gap.last > known[same].last) known[same] = gap;
      return;
    }
    known.push(gap);
    if (known.length > 2000) known.shift();
  }
  function addMark(mark) {
    if (marks.some((one) => one.time === mark.time && one.text === mark.text)) return;
    marks.push(mark);
    marks.sort((a, b) => a.time - b.time);
    if (marks.length > 2000) marks.shift();
  }

  // What is no finite number breaks the curve.
  function pointOf(time, least, mean, most, count) {
    const isNumber = [least, mean, most].every(Number.isFinite);
    return isNumber ? {time, least, mean, most, count} : {time, least: NaN, mean: NaN, most: NaN, count};
  }

  class Chart {
    constructor(fields) {
      this.fields = fields.map((field) => ({...field, past: [], fine: [], unit: ""}));
      this.fineFrom = Infinity;
      this.pastStep = 0;
      this.asked = 0;
      this.element = document.createElement("div");
      this.element.className = "chart";
      this.element.setAttribute("role", "figure");
      this.element.setAttribute("aria-label", "Chart of " + fields.map((one) => one.topic + "." + one.path).join(", "));
      this.legend = this.element.appendChild(document.createElement("div"));
      this.legend.className = "legend";
      this.plot = this.element.appendChild(document.createElement("div"));
      this.plot.className = "plot";
      this.reasons = this.element.appendChild(document.createElement("ul"));
      this.reasons.className = "reasons";
      document.getElementById("charts").append(this.element);
      this.makeLegend();
    }

    makeLegend() {
      this.legend.replaceChildren();
      this.fields.forEach((field, i) => {
        const entry = this.legend.appendChild(document.createElement("span"));
        const swatch = entry.appendChild(document.createElement("span"));
        swatch.className = "swatch";
        swatch.style.background = colours[i % colours.length];
        entry.append(field.topic + "." + field.path + (field.unit && field.unit !== "1" ? " in " + field.unit : "") + " ");
        field.shown = entry.appendChild(document.createElement("output"));
        const close = entry.appendChild(document.createElement("button"));
        close.type = "button";
        close.textContent = "×";
        close.setAttribute("aria-label", "Remove " + field.topic + "." + field.path + " from the chart");
        close.onclick = () => toggle(field.topic, field.path);
      });
      if (this.dygraph) this.dygraph.destroy();
      this.dygraph = null;
    }

    add(topic, origin, path, unit, time, step) {
      for (const field of this.fields) {
        if (field.topic !== topic || field.path !== path) continue;
        if (field.unit !== unit && unit !== undefined) {
          field.unit = unit;
          this.makeLegend();
        }
        field.origin = origin;
        field.fine.push(pointOf(time, step.least, step.mean, step.most, step.count));
        if (field.fine.length > mostFine) {
          field.fine.shift();
          this.fineFrom = Math.max(this.fineFrom, field.fine[0].time);
        }
        if (this.fineFrom === Infinity) this.fineFrom = time;
      }
    }
    // What came live has a hole.
    forget() {
      for (const field of this.fields) field.fine = [];
      this.fineFrom = Infinity;
    }

    // Asks for what is shown of before; the newest comes first.
    async fill(tell) {
      const window = shown();
      if (!window || window.until <= window.from || !charts.includes(this)) return;
      const number = ++this.asked, step = stepOf(window);
      const topics = {};
      for (const field of this.fields) (topics[field.topic] = topics[field.topic] || []).push(field.path);
      const points = this.fields.map(() => []);
      const from = window.from;
      let until = window.until + step;
      for (;;) {
        let answer;
        try { answer = await Server.history({topics, from, until, step, marks: true}); } catch { return; }
        if (number !== this.asked) return;  // another window is asked for since
        if (answer.error) return tell(answer.error, "bad");
        takeAnswer(answer);
        for (const series of answer.series) {
          const i = this.fields.findIndex((one) => one.topic === series.topic && one.path === series.path);
          if (i < 0) continue;
          this.fields[i].origin = series.origin;
          if (this.fields[i].unit !== series.unit) {
            this.fields[i].unit = series.unit;
            this.makeLegend();
          }
          points[i] = series.time.map((time, at) => pointOf(time, series.least[at], series.mean[at], series.most[at]))
            .concat(points[i]);
        }
        this.fields.forEach((field, i) => { field.past = points[i]; });
        this.pastStep = step;
        this.draw();
        tell(answer.reached > from ? "reading the values before " + timeText(answer.reached) : "", "");
        if (answer.reached <= from || answer.reached >= until) return;
        until = answer.reached;
      }
    }

    rows(window) {
      const step = stepOf(window);
      const table = new Map();
      const at = (time) => {
        if (!table.has(time)) table.set(time, new Array(this.fields.length).fill(null));
        return table.get(time);
      };
      const fineFrom = Math.ceil(this.fineFrom / step) * step;
      this.fields.forEach((field, i) => {
        for (const point of field.past)
          if (point.time >= window.from - step && point.time <= window.until && (point.time < fineFrom || this.pastStep < liveStep))
            at(point.time)[i] = [point.least, point.mean, point.most];
        if (step >= liveStep) {
          for (const point of field.fine) {
            const time = Math.floor(point.time / step) * step;
            if (time < fineFrom || time < window.from - step || time > window.until) continue;
            const row = at(time), known = row[i];
            if (Number.isNaN(point.mean)) {
              if (!known) row[i] = Object.assign([NaN, NaN, NaN], {count: 0});
            } else if (!known || known.count === 0) {
              row[i] = [point.least, point.mean, point.most];
              row[i].count = point.count;
            } else {
              known.count += point.count;
              known[0] = Math.min(known[0], point.least);
              known[1] += (point.mean / 2 - known[1] / 2) * (2 * point.count / known.count);
              known[2] = Math.max(known[2], point.most);
            }
          }
        }
        const times = [...table.keys()].filter((time) => table.get(time)[i]).sort((a, b) => a - b);
        for (const gap of this.gapsOf(field, window)) {
          // A gap breaks the curve where no step has anything between its ends.
          const next = times.findIndex((time) => time > gap.first);
          if (next > 0 && next < times.length && times[next] + step >= gap.last && times[next] - times[next - 1] > step) {
            const row = at((times[next - 1] + times[next]) / 2);
            row[i] = [NaN, NaN, NaN];
          }
        }
      });
      return [...table.keys()].sort((a, b) => a - b).map((time) => [new Date(Server.utc(time)), ...table.get(time)]);
    }

    gapsOf(field, window) {
      return (gaps.get(keyOf(field.topic, field.origin)) || []).filter((gap) => gap.last >= window.from && gap.first <= window.until);
    }

    draw() {
      const window = shown();
      if (!window) return;
      const rows = this.rows(window);
      this.drawn = rows;
      const style = getComputedStyle(document.documentElement);
      const text = style.getPropertyValue("--text"), grid = style.getPropertyValue("--grid");
      const dateWindow = [Server.utc(window.from), Server.utc(window.until)];
      const units = [...new Set(this.fields.map((field) => field.unit))];
      isDrawing = true;
      if (rows.length === 0) rows.push([new Date(dateWindow[0]), ...this.fields.map(() => null)]);
      if (!this.dygraph) {
        const labels = ["time", ...this.fields.map((_, i) => "s" + i)];
        const series = {};
        this.fields.forEach((field, i) => { series["s" + i] = {axis: units.indexOf(field.unit) === 1 ? "y2" : "y"}; });
        this.dygraph = new Dygraph(this.plot, rows, {
          labels, series, customBars: true, connectSeparatedPoints: true, labelsUTC: true, dateWindow, legend: "never",
          colors: this.fields.map((_, i) => colours[i % colours.length]), strokeWidth: 1.4, fillAlpha: .22, axisLabelFontSize: 12,
          axes: {y: {axisLabelWidth: 62}, y2: {axisLabelWidth: 62, independentTicks: true}}, animatedZooms: false, axisLineColor: text,
          gridLineColor: grid, includeZero: false, drawPoints: false, isZoomedIgnoreProgrammaticZoom: true,
          underlayCallback: (canvas, area, g) => this.underlay(canvas, area, g),
          highlightCallback: (_, time, points) => { this.showAt(time); for (const other of charts) if (other !== this) other.cursor(time); },
          unhighlightCallback: () => { for (const other of charts) { other.showAt(null); if (other !== this && other.dygraph) other.dygraph.clearSelection(); } },
          drawCallback: (g) => moved(g.xAxisRange()),
        });
      } else {
        this.dygraph.updateOptions({file: rows, dateWindow, axisLineColor: text, gridLineColor: grid});
      }
      isDrawing = false;
      if (!this.pointed) this.showAt(null);
      this.showReasons(window);
    }

    // The same instant in another chart.
    cursor(time) {
      if (!this.dygraph || !this.drawn.length) return;
      let row = this.drawn.findIndex((one) => +one[0] >= time);
      if (row < 0) row = this.drawn.length - 1;
      this.dygraph.setSelection(row);
      this.showAt(time);
    }
    showAt(time) {
      this.pointed = time !== null;
      const rows = this.drawn || [];
      this.fields.forEach((field, i) => {
        let text = "";
        for (const row of rows) {
          if (time !== null && +row[0] > time) break;
          const value = row[i + 1];
          if (value && !Number.isNaN(value[1])) text = valueText(value[1]) + (value[0] < value[2] ? ` (${valueText(value[0])} to ${valueText(value[2])})` : "");
        }
        field.shown.textContent = text;
      });
    }

    underlay(canvas, area, g) {
      const window = shown();
      if (!window) return;
      const style = getComputedStyle(document.documentElement);
      const x = (time) => Math.min(area.x + area.w, Math.max(area.x, g.toDomXCoord(Server.utc(time))));
      this.fields.forEach((field) => {
        for (const limit of limits) {
          if (limit.topic !== field.topic || (limit.path && limit.path !== field.path)) continue;
          const axis = this.dygraph && this.fields.length ? (this.axisOf(field) ? 1 : 0) : 0;
          const band = (from, until, colour) => {
            const top = until === Infinity ? area.y : Math.max(area.y, g.toDomYCoord(until, axis));
            const bottom = from === -Infinity ? area.y + area.h : Math.min(area.y + area.h, g.toDomYCoord(from, axis));
            if (bottom <= top) return;
            canvas.fillStyle = style.getPropertyValue(colour);
            canvas.fillRect(area.x, top, area.w, bottom - top);
          };
          if (limit.high !== undefined) band(limit.high, limit.high_high === undefined ? Infinity : limit.high_high, "--high");
          if (limit.high_high !== undefined) band(limit.high_high, Infinity, "--worst");
          if (limit.low !== undefined) band(limit.low_low === undefined ? -Infinity : limit.low_low, limit.low, "--high");
          if (limit.low_low !== undefined) band(-Infinity, limit.low_low, "--worst");
        }
        canvas.fillStyle = style.getPropertyValue("--gap");
        canvas.font = "11px system-ui";
        for (const gap of this.gapsOf(field, window)) {
          const left = x(gap.first), width = Math.max(3, x(gap.last) - left);
          canvas.fillStyle = style.getPropertyValue("--gap");
          canvas.fillRect(left, area.y, width, area.h);
          canvas.fillStyle = style.getPropertyValue("--text");
          const said = gapText(gap);
          if (canvas.measureText(said).width < width - 4) canvas.fillText(said, left + 2, area.y + 12);
        }
      });
      canvas.strokeStyle = canvas.fillStyle = style.getPropertyValue("--faint");
      let free = area.x;
      for (const mark of marks) {
        if (mark.time < window.from || mark.time > window.until) continue;
        const at = x(mark.time);
        canvas.beginPath();
        canvas.moveTo(at, area.y);
        canvas.lineTo(at, area.y + area.h);
        canvas.stroke();
        if (at < free) continue;
        const said = mark.text.slice(0, 40);
        canvas.fillText(said, at + 3, area.y + area.h - 4);
        free = at + canvas.measureText(said).width + 6;
      }
    }
    axisOf(field) {
      const units = [...new Set(this.fields.map((one) => one.unit))];
      return units.indexOf(field.unit) === 1 ? 1 : 0;
    }

    showReasons(window) {
      const all = [];
      for (const field of this.fields)
        for (const gap of this.gapsOf(field, window))
          if (!all.some((one) => one.gap === gap)) all.push({field, gap});
      all.sort((a, b) => b.gap.first - a.gap.first);
      const lines = all.slice(0, 5).map(({field, gap}) => timeText(gap.first) + " " + field.topic + ": " + gapText(gap));
      if (all.length > 5) lines.push(all.length - 5 + " more");
      if (this.reasons.dataset.said === lines.join("\n")) return;
      this.reasons.dataset.said = lines.join("\n");
      this.reasons.replaceChildren(...lines.map((line) => Object.assign(document.createElement("li"), {textContent: line})));
    }

    csv() {
      const head = ["time", ...this.fields.flatMap((field) => ["least", "mean", "most"].map((what) => `${field.topic}.${field.path} ${what}`))];
      const quoted = (text) => /[",\n]/.test(text) ? '"' + text.replaceAll('"', '""') + '"' : text;
      const lines = [head.map(quoted).join(",")];
      const window = shown();
      for (const row of this.drawn || []) {
        if (+row[0] < Server.utc(window.from) || +row[0] > Server.utc(window.until)) continue;
        const cells = row.slice(1).flatMap((value) => (value && !Number.isNaN(value[1]) ? value.slice(0, 3) : ["", "", ""]));
        if (cells.some((cell) => cell !== "")) lines.push([row[0].toISOString(), ...cells].join(","));
      }
      for (const field of this.fields)
        for (const gap of this.gapsOf(field, window))
          lines.push("# " + quoted(`${timeText(gap.first)} to ${timeText(gap.last)} ${field.topic}: ${gapText(gap)}`));
      return lines.join("\n") + "\n";
    }

    picture() {
      const box = this.element.getBoundingClientRect(), scale = devicePixelRatio || 1;
      const canvas = document.createElement("canvas");
      canvas.width = box.width * scale;
      canvas.height = box.height * scale;
      const to = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
      to.scale(scale, scale);
      to.fillStyle = style.getPropertyValue("--back");
      to.fillRect(0, 0, box.width, box.height);
      for (const one of this.plot.querySelectorAll("canvas")) {
        const at = one.getBoundingClientRect();
        to.drawImage(one, at.left - box.left, at.top - box.top, at.width, at.height);
      }
      to.fillStyle = style.getPropertyValue("--text");
      to.font = "12px system-ui";
      to.textBaseline = "top";
      for (const label of this.element.querySelectorAll(".dygraph-axis-label, .legend > span, .reasons li")) {
        const at = label.getBoundingClientRect();
        to.fillText(label.textContent.replace("×", ""), at.left - box.left, at.top - box.top);
      }
      this.fields.forEach((_, i) => {
        const at = this.legend.querySelectorAll(".swatch")[i].getBoundingClientRect();
        to.fillStyle = colours[i % colours.length];
        to.fillRect(at.left - box.left, at.top - box.top, at.width, at.height);
      });
      return canvas;
    }
  }

  // Somebody zoomed or panned.
  let waiting = 0;
  function moved([from, until]) {
    if (isDrawing) return;
    const offset = Server.utc(0), window = shown();
    if (!window || (Math.abs(from - offset - window.from) < 1 && Math.abs(until - offset - window.until) < 1)) return;
    view = {from: from - offset, until: until - offset};
    setPaused(true);
    clearTimeout(waiting);
    waiting = setTimeout(() => { drawAll(); fillAll(); }, 200);
  }

  function takeAnswer(answer) {
    if (answer.run) {
      runStart = answer.run.started;
      told.run(answer.run);
    }
    for (const gap of answer.gaps) addGap(gap);
    for (const event of answer.marks) told.mark(event);
  }
  const told = {run() {}, mark() {}, paused() {}, changed() {}, history() {}};

  function setPaused(wanted) {
    if (wanted && !isPaused && !view) view = shown();
    if (!wanted) view = null;
    isPaused = wanted;
    told.paused(isPaused);
  }
  function drawAll() {
    for (const chart of charts) chart.draw();
  }
  function fillAll() {
    for (const chart of charts) chart.fill(told.history);
  }

  function toggle(topic, path) {
    const chart = charts.find((one) => one.fields.some((field) => field.topic === topic && field.path === path));
    if (chart) {
      chart.fields = chart.fields.filter((field) => field.topic !== topic || field.path !== path);
      if (chart.fields.length === 0) {
        if (chart.dygraph) chart.dygraph.destroy();
        ++chart.asked;  // what is on its way is not drawn
        chart.element.remove();
        charts.splice(charts.indexOf(chart), 1);
      } else {
        chart.makeLegend();
        chart.draw();
      }
    } else {
      open([{topic, path}], true);
    }
    told.changed();
  }
  // `joins`: fields of the unit of an open chart, or of a second unit, go into it.
  function open(fields, joins, unitOf = told.unitOf) {
    const unit = unitOf ? unitOf(fields[0].topic, fields[0].path) : "";
    const last = charts[charts.length - 1];
    if (joins && last && last.fields.length < colours.length) {
      const units = new Set(last.fields.map((field) => field.unit));
      if (units.has(unit) || units.size < 2) {
        last.fields.push({...fields[0], past: [], fine: [], unit});
        last.forget();
        last.makeLegend();
        last.fill(told.history);
        setTimeout(() => last.fill(told.history), 2500);
        return;
      }
    }
    const chart = new Chart(fields);
    for (const field of chart.fields) field.unit = unitOf ? unitOf(field.topic, field.path) : "";
    chart.makeLegend();
    charts.push(chart);
    chart.fill(told.history);
    setTimeout(() => chart.fill(told.history), 2500);  // what was on its way to the disk
  }

  function timeText(recorded) {
    return new Date(Server.utc(recorded)).toISOString().replace("T", " ").replace(/(\.\d*)?Z$/, (all) => (all.length > 1 ? all.slice(0, 4) : ""));
  }
  function gapText(gap) {
    const what = gap.kind === "joined" ? "several gaps joined" : gap.kind;
    return (gap.count ? gap.count + " " : "") + what + (gap.reason && gap.reason !== gap.kind ? ": " + gap.reason : "");
  }
  function valueText(value) {
    if (value === null || value === undefined) return "";
    if (typeof value === "string") return value;
    if (!Number.isFinite(value)) return String(value);
    const size = Math.abs(value);
    return size !== 0 && (size >= 1e7 || size < 1e-4) ? value.toExponential(4) : String(+value.toPrecision(6));
  }

  return {
    charts, told, addGap, addMark, toggle, open, drawAll, fillAll, timeText, gapText, valueText, marks,
    gapsOf: (topic, origin) => gaps.get(keyOf(topic, origin)) || [],
    allGaps: () => [...gaps.values()].flat(),
    setRange(ms) { range = ms; view = null; isPaused = false; told.paused(false); drawAll(); fillAll(); },
    range: () => range,
    setPaused(wanted) { setPaused(wanted); drawAll(); if (!wanted) fillAll(); },
    isPaused: () => isPaused,
    setLimits(all) { limits = all; },
    setRun(start, ended) { runStart = start; runEnd = ended; },
    step(topic, origin, path, unit, time, step) { for (const chart of charts) chart.add(topic, origin, path, unit, time, step); },
    forget() { for (const chart of charts) chart.forget(); },
    // What is known of another run.
    forgetRun() {
      gaps.clear();
      marks.length = 0;
      for (const chart of charts) for (const field of chart.fields) field.past = [];
    },
    turn() { if (!isPaused) drawAll(); },
    shown,
  };
})();
