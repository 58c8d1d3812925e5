// The live page in a real browser while something goes wrong: page_faults_test.mjs PROGRAM [FOLDER_OF_PICTURES].
import assert from "node:assert/strict";
import {execFileSync, spawn} from "node:child_process";
import {closeSync, copyFileSync, openSync, renameSync, statSync, writeFileSync, writeSync} from "node:fs";
import {connect, createServer} from "node:net";
import {join} from "node:path";
import {browser, end, environment, failed, folder, open, patience, problems, program, shot, start, test, text, until} from "./browser.mjs";

const token = "0123456789abcdef0123";
const wait = (seconds) => new Promise((done) => setTimeout(done, seconds * 1000));
const configure = (file, content) => writeFileSync(join(folder, file), JSON.stringify(content));
const cpu = {name: "cpu", type: "host", quantity: "cpu", rate: "10 Hz", topic: "host/cpu"};
const recorded = (path) => [{type: "sqlite", name: "rec", path}];
/// The texts of a row of the values: name, value, unit, age; and whether it is grey.
const rowOf = (page, key) => page.evaluate((key) => {
  const row = [...document.querySelectorAll("#values tbody tr")].find((one) => one.dataset.key === key);
  return row && {name: row.cells[1].textContent, value: row.cells[2].textContent, unit: row.cells[3].textContent, age: row.cells[4].textContent,
                 isStale: row.classList.contains("stale")};
}, key);
/// Waits until its row is so, a minute at most.
async function untilRow(page, key, isSo = () => true) {
  const last = Date.now() + patience;
  for (;;) {
    const row = await rowOf(page, key);
    if (row && isSo(row)) return;
    if (Date.now() > last) throw new Error(`${key} is ${JSON.stringify(row)}`);
    await wait(0.2);
  }
}
const isLive = (page) => until(page, () => document.getElementById("connection").textContent === "live");
const chartOf = (page, field) => page.evaluate((field) => {
  const [topic, path] = field;
  if (!Charts.charts.some((one) => one.fields.some((known) => known.topic === topic && known.path === path))) Charts.toggle(topic, path);
}, field);
/// The browser's clock is wrong by so many ms; `setClock(ms)` in the page sets it.
const withClock = (by) => (page) => page.evaluateOnNewDocument((by) => {
  const Real = Date;
  window.setClock = (ms) => { by = ms; };
  window.Date = class extends Real {
    constructor(...words) { words.length ? super(...words) : super(Real.now() + by); }
    static now() { return Real.now() + by; }
  };
}, by);
/// The browser's clock of durations runs too fast.
const withFastClock = (factor) => (page) => page.evaluateOnNewDocument((factor) => {
  const real = performance.now.bind(performance);
  performance.now = () => real() * factor;
}, factor);
const sayNothing = () => {};

// A device that sends numbers that are none, nothing, and a long text.
const device = spawn("python3", ["-c", `
import os, pty, sys, time, tty
ours, theirs = pty.openpty()
tty.setraw(theirs)
print(os.ttyname(theirs), flush=True)
n = 0
while True:
    n += 1
    os.write(ours, b"%d,nan,inf,-inf,,%s\\n" % (n, b"\\xc3\\xbc<b>'" + b"x" * 240))
    time.sleep(0.1)
`]);
device.on("error", sayNothing);
const devicePath = await new Promise((done) => {
  device.stdout?.on("data", (said) => done(String(said).trim()));
  device.on("error", () => done(null));
  device.on("exit", () => done(null));
});
const odd = "last \"Prüf\" <b>";
configure("bench.json", {
  name: "bench", notes: "ü<b>" + "n".repeat(4000), page: {listen: "127.0.0.1:0", token, commands: ["note"]},
  sensors: [cpu, {name: odd, type: "host", quantity: "load", rate: "2 Hz", topic: "host/load"},
    ...(devicePath ? [{name: "line", type: "serial", device: devicePath, topic: "line", fields: [
      {name: "count", type: "uint32"}, {name: "nan"}, {name: "inf"}, {name: "minus"}, {name: "absent", optional: true}, {name: "text", type: "text", length: 255}]}] : [])],
  sinks: recorded("bench.db"),
});

try {
  const run = start("run", "bench.json");
  const address = await run.address;
  const page = await open(address);
  const fast = await open(address, 800, 600, withFastClock(1.05));
  await isLive(page);

  await test("BY-1 a browser whose clock is wrong, or is set: ages, grey and charts go by the instance's time", async () => {
    for (const by of [3600e3, -3600e3]) {
      const other = await open(address, 1100, 800, withClock(by));
      await isLive(other);
      assert.ok(Math.abs(await other.evaluate(() => Date.now()) - by - Date.now()) < 60e3, "the browser's clock is not wrong");
      const isRight = async () => {
        await until(other, () => Charts.charts.length && Charts.charts[0].drawn.length > 3);
        await untilRow(other, "host/cpu|cpu|busy", (row) => /^[0-4]\.\d s$/.test(row.age) && !row.isStale);
        const [shown, last, utc] = await other.evaluate(() => [Server.utc(Charts.shown().until), +Charts.charts[0].drawn.at(-1)[0], document.getElementById("utc").textContent]);
        for (const time of [shown, last, Date.parse(utc.slice(0, 19) + "Z")]) assert.ok(Math.abs(time - Date.now()) < 20e3, `${new Date(time)} for ${new Date()}`);
      };
      await isRight();
      await other.evaluate((by) => setClock(-2 * by), by);
      await wait(1);
      await isRight();
      await other.close();
    }
  });

  await test("BY-1 numbers that are none, what is absent, and long texts are shown as such, never as 0", async () => {
    if (!devicePath) return console.log("todo: there is no python3, and so no serial line: this is not tried");
    await untilRow(page, "line|line|count", (row) => /^\d+$/.test(row.value));
    await untilRow(page, "line|line|inf", (row) => row.value === "Infinity");
    await untilRow(page, "line|line|minus", (row) => row.value === "-Infinity");
    for (const path of ["nan", "absent"]) {
      const row = await rowOf(page, `line|line|${path}`);
      assert.ok(!row || !/\d/.test(row.value), `${path}: ${row && row.value}`);
    }
    for (const path of ["nan", "inf", "minus", "absent", "count"]) await chartOf(page, ["line", path]);
    await wait(3);
    const drawn = await page.evaluate(() => Charts.charts.map((chart) => ({
      names: chart.fields.map((one) => one.path), values: chart.fields.map((_, i) => chart.drawn.map((row) => row[i + 1]).filter((one) => one).flat()),
      axis: chart.dygraph.yAxisRange(), csv: chart.csv(), legend: chart.legend.textContent})));
    for (const chart of drawn) {
      assert.ok(chart.axis.every(Number.isFinite), "the axis is " + chart.axis);
      for (const [i, path] of chart.names.entries())
        if (["nan", "inf", "minus", "absent"].includes(path))
          assert.deepEqual(chart.values[i].filter((value) => value !== null && Number.isFinite(+value)), [], path);
      const count = chart.names.indexOf("count");
      if (count >= 0) assert.ok(chart.values[count].filter((value) => Number.isFinite(value) && value > 0).length > 3, "the one that is a number has no curve");
      assert.doesNotMatch(chart.csv, /NaN|undefined/);
    }
    for (const path of ["nan", "inf", "minus", "absent", "count"]) await page.evaluate((path) => Charts.toggle("line", path), path);
    assert.ok((await page.$eval("#sensors", (one) => one.textContent)).includes(odd));
    await until(page, () => /^run 1: ü<b>n{4000}$/.test(document.getElementById("run").textContent));
    execFileSync(program, ["ctl", "bench", "note", "ü<b>" + "y".repeat(230)], {cwd: folder, env: environment});  // as long as it may be
    await until(page, () => /note ü<b>y{230}/.test(document.getElementById("events").textContent));
    assert.equal(await page.$$eval("#values b, #sensors b, #events b, #run b", (all) => all.length), 0);
    assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), "it is wider than the window");
  });

  await test("BY-1 on a phone of 360 px long texts make nothing wider; a finger pans the charts; the wall shows them alone", async () => {
    const phone = await open(address, 360, 700, (one) => one.setViewport({width: 360, height: 700, hasTouch: true, isMobile: true}));
    await isLive(phone);
    await until(phone, () => Charts.charts.length && Charts.charts[0].drawn.length > 5);
    await until(phone, () => document.querySelectorAll("#values tbody tr").length > 3);
    const width = () => phone.evaluate(() => document.documentElement.scrollWidth);
    assert.ok(await width() <= 360, "it is wider: " + await width());
    assert.ok(await phone.$eval("#top", (one) => one.offsetHeight) < 350, "notes of 4000 letters cover half of it");
    const before = await phone.evaluate(() => Charts.shown());
    const box = await (await phone.$(".plot")).boundingBox();
    const cdp = await phone.createCDPSession();
    const touch = (type, ...x) => cdp.send("Input.dispatchTouchEvent", {type, touchPoints: x.map((x, id) => ({x: box.x + x, y: box.y + 80, id}))});
    await touch("touchStart", 120);
    for (let x = 130; x <= 250; x += 20) await touch("touchMove", x);
    await touch("touchEnd");
    await until(phone, () => Charts.isPaused());
    const panned = await phone.evaluate(() => Charts.shown());
    assert.ok(panned.until < before.until - 5e3, `from ${before.until} to ${panned.until}`);
    assert.ok(Math.abs(panned.until - panned.from - (before.until - before.from)) < 1500, "it was zoomed");
    await touch("touchStart", 130, 200);
    for (let i = 1; i <= 6; ++i) await touch("touchMove", 130 - i * 10, 200 + i * 10);
    await touch("touchEnd");
    await until(phone, (most) => Charts.shown().until - Charts.shown().from < most, (panned.until - panned.from) * 0.9);
    await phone.click("#wall");
    await until(phone, () => !document.getElementById("values").checkVisibility() && document.querySelector(".plot").checkVisibility());
    await phone.click("#pause");
    await until(phone, () => !Charts.isPaused() && /\d/.test(document.querySelector(".legend output").textContent));
    assert.ok(await width() <= 360, "the wall is wider: " + await width());
    assert.match(phone.url(), /view=wall/);
    const wall = await open(phone.url() + "&token=" + token, 1600, 900);
    await until(wall, () => !document.getElementById("values").checkVisibility() && Charts.charts.length && Charts.charts[0].drawn.length > 5
      && /\d/.test(document.querySelector(".legend output").textContent));
    await shot(wall, "page-wall.png");
    await wall.close();
    await phone.close();
  });

  await test("BY-1 a page that was frozen, or whose browser stood still, catches up: no hole, no wrong curve", async () => {
    const of = address.replace("#", "#chart=host%2Fcpu.busy&"), stopped = await open(of), frozen = await open(of);
    for (const one of [stopped, frozen]) {
      await isLive(one);
      await until(one, () => Charts.charts.length && Charts.charts[0].drawn.length > 5);
    }
    const cdp = await frozen.createCDPSession();
    await cdp.send("Page.setWebLifecycleState", {state: "frozen"});
    const from = Date.now();
    await wait(2);
    const renderers = (await (await browser.target().createCDPSession()).send("SystemInfo.getProcessInfo")).processInfo
      .filter((one) => one.type === "renderer").map((one) => one.id);
    assert.ok(renderers.length > 0);
    for (const pid of renderers) process.kill(pid, "SIGSTOP");
    await wait(11);
    for (const pid of renderers) process.kill(pid, "SIGCONT");
    await cdp.send("Page.setWebLifecycleState", {state: "active"});
    for (const one of [stopped, frozen]) {
      await isLive(one);
      // One that was frozen stays hidden here, and so its table is not drawn.
      if (one === stopped) await untilRow(one, "host/cpu|cpu|busy", (row) => /^[01]\.\d s$/.test(row.age) && !row.isStale);
      // Each second of it has a point, or the page says what it left out.
      await until(one, (from) => {
        const drawn = Charts.charts[0].drawn.filter((row) => row[1] && Number.isFinite(row[1][1])).map((row) => +row[0]);
        return drawn.every((time, i) => i === 0 || time > drawn[i - 1]) &&
          Array.from({length: 12}, (_, i) => from + i * 1000).every((second) => drawn.some((time) => time >= second && time < second + 1500));
      }, from);
      assert.ok(await one.evaluate(() => Charts.charts[0].drawn.every((row) => !row[1] || Number.isNaN(row[1][1]) || row[1][1] >= 0 && row[1][1] <= 100)));
    }
    await stopped.close();
    await frozen.close();
  });

  await test("BY-1 a unit, a sensor more and a sensor less by a reload are shown without loading the page again", async () => {
    const configured = (name, unit, more) => configure("reload.json", {page: {listen: "127.0.0.1:0", token}, sinks: recorded("reload.db"), sensors: [
      {name, type: "derived", on: "r/load", topic: "r/" + name, expression: "running + 1", unit}, {name: "load", type: "host", quantity: "load", rate: "4 Hz", topic: "r/load"},
      {name: more, type: "host", quantity: "memory", rate: "4 Hz", topic: "r/" + more}]});
    configured("volts", "V", "old");
    const reloaded = start("run", "reload.json");
    const shown = await open(await reloaded.address);
    await untilRow(shown, "r/volts|volts|value", (row) => row.unit === "V");
    await untilRow(shown, "r/old|old|free");
    await chartOf(shown, ["r/volts", "value"]);
    // Another unit of the same topic is refused: it stays as it was.
    configured("volts", "mV", "old");
    reloaded.child.kill("SIGHUP");
    for (let i = 0; i < 300 && !/refused/.test(reloaded.child.said); ++i) await wait(0.2);
    assert.match(reloaded.child.said, /refused: the topic r\/volts carries other values/);
    await untilRow(shown, "r/volts|volts|value", (row) => row.unit === "V" && /^[01]\.\d s$/.test(row.age) && !row.isStale);
    configured("millivolts", "mV", "new");
    reloaded.child.kill("SIGHUP");
    await untilRow(shown, "r/new|new|free", (row) => /\d/.test(row.value) && row.unit === "By" && !row.isStale);
    await untilRow(shown, "r/millivolts|millivolts|value", (row) => row.unit === "mV" && /^[01]\.\d s$/.test(row.age));
    await chartOf(shown, ["r/millivolts", "value"]);
    for (const named of ["r/volts.value in V ", "r/millivolts.value in mV "])
      await until(shown, (named) => Charts.charts.some((chart) => chart.legend.textContent.includes(named)), named);
    for (const gone of ["r/old|old|free", "r/volts|volts|value"]) await untilRow(shown, gone, (row) => row.isStale && row.age === "gone");
    await isLive(shown);
    await shown.close();
    reloaded.child.kill("SIGTERM");
    await reloaded.child.ended;
  });

  await test("BY-1 the program is killed and started again: the page goes on by itself, with the new run alone", async () => {
    const free = createServer().listen(0, "127.0.0.1");
    await new Promise((done) => free.once("listening", done));
    const listen = "127.0.0.1:" + free.address().port;
    await new Promise((done) => free.close(done));
    const configured = (name, quantity) => configure("again.json", {name, page: {listen, token}, sinks: recorded("again.db"),
      sensors: [cpu, {name, type: "host", quantity, rate: "5 Hz", topic: "run/" + name}]});
    configured("first", "load");
    const first = start("run", "again.json");
    const shown = await open(await first.address);
    await untilRow(shown, "run/first|first|running", (row) => /\d/.test(row.value));
    await chartOf(shown, ["host/cpu", "busy"]);
    await until(shown, () => document.getElementById("run").textContent.startsWith("run 1") && Charts.charts.some((one) => one.drawn.length > 8));
    first.child.kill("SIGSTOP");  // a gap, which is of this run
    await wait(1.5);
    first.child.kill("SIGCONT");
    await until(shown, () => Charts.allGaps().length > 0);
    first.child.kill("SIGKILL");
    await first.child.ended;
    await until(shown, () => document.getElementById("top").classList.contains("silent") && /no data for/.test(document.getElementById("connection").textContent));
    configured("second", "memory");
    const again = Date.now(), second = start("run", "again.json");
    await second.address;
    await isLive(shown);
    await until(shown, () => document.getElementById("name").textContent === "second" && document.getElementById("run").textContent.startsWith("run 2"));
    await untilRow(shown, "run/second|second|free", (row) => /\d/.test(row.value));
    await until(shown, () => Charts.charts.some((chart) => chart.fields[0].path === "busy" && chart.drawn.length > 4));
    await until(shown, () => ![...document.querySelectorAll("#values tbody tr")].some((one) => one.dataset.key.startsWith("run/first|")));
    const mixed = await shown.evaluate((again) => ({
      points: Charts.charts.flatMap((chart) => chart.drawn.map((row) => +row[0])).filter((time) => time < again - 1000).length,
      gaps: Charts.allGaps().filter((gap) => gap.last < again - 1000).length}), again);
    assert.deepEqual(mixed, {points: 0, gaps: 0});
    await shown.close();
    second.child.kill("SIGTERM");
    assert.equal(await second.child.ended, 0, second.child.said);
  });

  await test("BY-1 over TLS the page works, and commands; who does not speak it does no harm", async () => {
    execFileSync("openssl", ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1",
      "-keyout", join(folder, "key.pem"), "-out", join(folder, "cert.pem")], {stdio: "ignore"});
    configure("tls.json", {page: {listen: "127.0.0.1:0", token, tls: {certificate: "cert.pem", key: "key.pem"}, commands: ["set", "arm", "disarm", "note"]},
      sensors: [cpu], outputs: [{name: "lamp", type: "http", url: "http://127.0.0.1:9/{value}", method: "get", safe: 0, armed: "by command"}],
      sinks: recorded("tls.db")});
    const run = start("run", "tls.json");
    const address = await run.address;
    assert.match(address, /^https:/);
    const shown = await open(address);
    await isLive(shown);
    await untilRow(shown, "host/cpu|cpu|busy", (row) => /^[01]\.\d s$/.test(row.age));
    const port = +new URL(address).port;
    for (const said of ["GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", "\x16\x03\x01\x02\x00" + "\xff".repeat(600), "x".repeat(100000), ""]) {
      const socket = connect(port, "127.0.0.1");
      socket.on("error", sayNothing);
      let heard = "";
      socket.on("data", (data) => { heard += data; });
      socket.end(said, "latin1");
      await Promise.race([new Promise((done) => socket.on("close", done)), wait(2)]);
      socket.destroy();
      assert.doesNotMatch(heard, /rt-data|HTTP\/1.1 200/);
    }
    const hold = await (await shown.$("#commands button.hold")).boundingBox();
    await shown.evaluate((y) => scrollTo(0, y), hold.y);
    const seen = await (await shown.$("#commands button.hold")).boundingBox();
    await shown.mouse.move(seen.x + 5, seen.y + 5);
    await shown.mouse.down();
    await until(shown, () => /arm.*is armed$/.test(document.getElementById("answer").textContent));
    await shown.mouse.up();
    await shown.type("#commands form[aria-label=Set] input", "1");
    await shown.click("#commands form[aria-label=Set] button");
    await until(shown, () => /^set lamp 1: /.test(document.getElementById("answer").textContent));
    await untilRow(shown, "host/cpu|cpu|busy", (row) => /^[01]\.\d s$/.test(row.age));
    await shown.close();
    run.child.kill("SIGTERM");
    await run.child.ended;
  });

  await test("BY-1 500 topics: all are found, what is left out is counted, and the page answers at once", async () => {
    const many = 500, name = (i) => "s" + String(i).padStart(3, "0");
    configure("many.json", {page: {listen: "127.0.0.1:0", token}, sinks: recorded("many.db"), sensors: Array.from({length: many}, (_, i) =>
      ({name: name(i), type: "host", quantity: "process", rate: "0.5 Hz", topic: "many/" + name(i)}))});
    const run = start("run", "many.json");
    const shown = await open(await run.address);
    await isLive(shown);
    await until(shown, () => document.querySelectorAll("#values tbody tr").length === 200 && document.getElementById("more").textContent === "1800 more: filter them");
    await shown.type("#filter", "s499.");
    await until(shown, () => { const rows = [...document.querySelectorAll("#values tbody tr")]; return rows.length === 4 && rows.every((one) => one.dataset.key.startsWith("many/s499|")); });
    assert.equal(await text(shown, "#more"), "");
    await untilRow(shown, "many/s499|s499|run_time", (row) => /\d/.test(row.value));
    await shown.click("#values tbody tr:nth-child(2) button.field");
    await until(shown, () => Charts.charts.some((one) => one.fields.some((field) => field.topic === "many/s499") && one.drawn.length > 1));
    await shown.$eval("#filter", (one) => { one.value = ""; one.dispatchEvent(new Event("input")); });
    const slowest = await shown.evaluate(async () => {
      let slowest = 0;
      for (let i = 0, before = performance.now(); i < 100; ++i) {
        await new Promise((done) => setTimeout(done, 30));
        const now = performance.now();
        slowest = Math.max(slowest, now - before - 30);
        before = now;
      }
      return slowest;
    });
    assert.ok(slowest < 1500, `it stood still for ${slowest} ms`);
    const {JSHeapUsedSize} = await shown.metrics();
    assert.ok(JSHeapUsedSize < 100e6, `${JSHeapUsedSize} bytes`);
    await shown.close();
    run.child.kill("SIGTERM");
    assert.equal(await run.child.ended, 0, run.child.said);
  });

  await test("BY-1 the recording of a run is moved away while it is viewed: in words, and all else goes on", async () => {
    configure("moved.json", {page: {listen: "127.0.0.1:0", token}, sensors: [cpu], sinks: recorded("moved.db")});
    const run = start("run", "moved.json");
    const live = await open(await run.address);
    await isLive(live);
    await until(live, () => Charts.charts.length && Charts.charts[0].fields[0].past.length > 3);
    const viewing = start("view", "moved.db", "--listen", "127.0.0.1:0");
    const viewed = await open(await viewing.address);
    await isLive(viewed);
    await until(viewed, () => Charts.charts.length && Charts.charts[0].drawn.length > 3);
    renameSync(join(folder, "moved.db"), join(folder, "elsewhere.db"));
    for (const one of [live, viewed]) {
      await one.select("#range", "10 min");
      await until(one, () => /moved\.db/.test(document.getElementById("history").textContent) && document.getElementById("history").className === "bad");
    }
    await untilRow(live, "host/cpu|cpu|busy", (row) => /^[01]\.\d s$/.test(row.age));
    await isLive(live);
    await until(viewed, () => /moved\.db/.test(document.getElementById("failed").textContent));
    // Back again, all is as before.
    renameSync(join(folder, "elsewhere.db"), join(folder, "moved.db"));
    await live.select("#range", "1 min");
    await until(live, () => document.getElementById("history").textContent === "" && Charts.charts[0].drawn.length > 3);
    assert.equal(viewing.child.exitCode, null);
    viewing.child.kill("SIGTERM");
    assert.equal(await viewing.child.ended, 0, viewing.child.said);
    await live.close();
    await viewed.close();
    run.child.kill("SIGTERM");
    await run.child.ended;
  });

  await test("BY-1 the recorder is killed while its recording is viewed: it is at rest, and what is not known is said", async () => {
    configure("killed.json", {page: {listen: "127.0.0.1:0", token}, sensors: [cpu], sinks: recorded("killed.db")});
    const recorder = start("run", "killed.json");
    await recorder.address;
    const viewing = start("view", "killed.db", "--listen", "127.0.0.1:0");
    const viewed = await open(await viewing.address);
    await isLive(viewed);
    recorder.child.kill("SIGKILL");
    await recorder.child.ended;
    await until(viewed, () => document.getElementById("connection").textContent === "recording (not running)");
    await until(viewed, () => /as far as is known/.test(document.getElementById("lost").textContent));
    await viewed.close();
    viewing.child.kill("SIGTERM");
    assert.equal(await viewing.child.ended, 0, viewing.child.said);
  });

  await test("BY-1 a clock that runs too fast does not make the present run away", async () => {
    const ahead = await fast.evaluate(() => [Server.utc(Server.now()), performance.now()]);
    assert.ok(ahead[1] > 40e3, "it was not open for long enough");
    assert.ok(Math.abs(ahead[0] - Date.now()) < 1800, `${ahead[0] - Date.now()} ms`);
    await untilRow(fast, "host/cpu|cpu|busy", (row) => /^[01]\.\d s$/.test(row.age) && !row.isStale);
  });

  await test("BY-1 a recording that is damaged, replaced or moved while it is viewed is an error in words", async () => {
    run.child.kill("SIGTERM");
    await run.child.ended;
    await page.close();
    await fast.close();
    const spoil = {
      damaged: (path) => {
        const file = openSync(path, "r+"), size = statSync(path).size;
        for (let at = 8192; at < size; at += 4096) writeSync(file, Buffer.alloc(3000, 0xa5), 0, 3000, at);
        closeSync(file);
      },
      replaced: (path) => { writeFileSync(path + ".new", "this is no recording\n".repeat(1000)); renameSync(path + ".new", path); },
      moved: (path) => renameSync(path, path + ".gone"),
    };
    for (const [how, act] of Object.entries(spoil)) {
      const name = how + ".db";
      copyFileSync(join(folder, "bench.db"), join(folder, name));
      const viewing = start("view", name, "--listen", "127.0.0.1:0");
      const address = await viewing.address;
      const shown = await open(address.replace("#", "#range=all&"));
      await until(shown, () => document.getElementById("connection").textContent === "recording (not running)");
      await until(shown, () => Charts.charts.length && Charts.charts[0].drawn.length > 5);
      act(join(folder, name));
      await shown.select("#range", "10 min");
      await until(shown, () => document.getElementById("history").textContent.length > 10 && document.getElementById("history").className === "bad");
      await until(shown, () => document.getElementById("failed").textContent.length > 10);
      assert.match(await text(shown, "#history"), /recording|database|file|\.db/);
      assert.equal(await text(shown, "#connection"), "recording (not running)");  // the connection is not what fails
      // Who comes now is told as well.
      const other = await open(address);
      await until(other, () => document.getElementById("failed").textContent.length > 10);
      assert.equal(viewing.child.exitCode, null, viewing.child.said);
      assert.equal(viewing.child.signalCode, null, viewing.child.said);
      viewing.child.kill("SIGTERM");
      assert.equal(await viewing.child.ended, 0, viewing.child.said);
      await shown.close();
      await other.close();
    }
  });

  await test("BY-1 whatever went wrong, no page made an error of its own", () => {
    assert.deepEqual(problems.filter((one) => !/ERR_(CONNECTION|INCOMPLETE|EMPTY)|status of 503/.test(one)), []);
  });
} finally {
  device.kill();
  await end();
}
process.exit(failed() ? 1 : 0);
