// The live page in a real browser, of a real run: page_test.mjs PROGRAM [FOLDER_OF_PICTURES].
import assert from "node:assert/strict";
import {writeFileSync} from "node:fs";
import {createServer} from "node:http";
import {join} from "node:path";
import {end, failed, folder, open, problems, shot, start, test, text, until} from "./browser.mjs";

const evil = "<img src=x onerror=window.evil=1>";
const device = createServer((request, answer) => { answer.end("ok"); }).listen(0, "127.0.0.1");
await new Promise((done) => device.once("listening", done));
writeFileSync(join(folder, "bench.json"), JSON.stringify({
  name: "bench " + evil, notes: "notes " + evil,
  page: {listen: "127.0.0.1:0", commands: ["note", "ack", "event", "set", "arm", "disarm", "start", "stop"]},
  sensors: [
    {name: "load", type: "host", quantity: "load", rate: "5 Hz", topic: "host/load"},
    {name: "cpu", type: "host", quantity: "cpu", rate: "20 Hz", topic: "host/cpu"},
    {name: "mem", type: "host", quantity: "memory", rate: "1 Hz", topic: "host/memory"},
    {name: evil, type: "host", quantity: "process", rate: "2 Hz", topic: "host/process"},
    {name: "never", type: "analog", file: "there-is-none " + evil, rate: "1 Hz", topic: "never"},
    {name: "busy", type: "limit", on: "host/cpu", field: "busy", high: -1, high_high: 200, topic: "busy"},
  ],
  outputs: [{name: "lamp", type: "http", url: `http://127.0.0.1:${device.address().port}/{value}`, method: "get", safe: 0, armed: "by command"}],
  machines: [{name: "flight", inputs: ["host/load"], start: "pad", states: [{name: "pad"}, {name: "up"}],
              transitions: [{from: "pad", to: "up", event: "launch"}, {from: "up", to: "pad", after: "1 h"}]}],
  sinks: [{type: "sqlite", name: "rec", path: "bench.db"}],
}));

try {
  const run = start("run", "bench.json");
  const address = await run.address;
  const page = await open(address);

  await test("BY-1 the line at the top says what is recorded, since when, by what clock, and what was lost", async () => {
    await until(page, () => document.getElementById("connection").textContent === "live");
    await until(page, () => /^recording since 20/.test(document.getElementById("since").textContent));
    await until(page, () => /^run 1: notes </.test(document.getElementById("run").textContent));
    await until(page, () => /UTC (±|\(accuracy)/.test(document.getElementById("utc").textContent));
    await until(page, () => /GiB, .* h$/.test(document.getElementById("disk").textContent));
    await until(page, () => /^alarm: busy high$/.test(document.getElementById("alarm").textContent));
    await until(page, () => /lost since the start: [1-9]/.test(document.getElementById("lost").textContent));  // of `never`
    await page.click("#lost");
    await until(page, () => /never/.test(document.getElementById("lost-of").textContent));
    await until(page, () => /until nowneverfaulted.*there-is-none/.test(document.getElementById("lost-when").textContent));
    await page.$eval("#losses button", (one) => one.click());
  });

  await test("BY-1 the token is out of the address, and a page without it is not let in", async () => {
    assert.doesNotMatch(page.url(), /token/);
    const other = await open(address.replace(/#.*/, "#token=wrong-wrong-wrong"));
    await until(other, () => document.getElementById("token-error").textContent.includes("token is wrong"));
    await other.type("#token", address.match(/token=(.*)/)[1]);
    await other.keyboard.press("Enter");
    await until(other, () => document.getElementById("connection").textContent === "live");
    await other.close();
    for (let i = problems.length - 1; i >= 0; --i) if (/401/.test(problems[i])) problems.splice(i, 1);
  });

  await test("BY-1 the table has each value with unit, age, rate and curve; filter and pin; the stale one is grey", async () => {
    await until(page, () => [...document.querySelectorAll("#values tbody tr")].length >= 5);
    const row = await page.$$eval("#values tbody tr", (rows) => rows.filter((one) => one.dataset.key === "host/cpu|cpu|busy").map((one) => [...one.cells].map((cell) => cell.textContent))[0]);
    assert.equal(row[1], "host/cpu.busy");
    assert.match(row[2], /^[\d.e-]+$/);
    assert.match(row[4], /^0\.\d s$/);
    await until(page, () => /^(19|20|21)(\.\d)? of 20 Hz$/.test([...document.querySelectorAll("#values tbody tr")].find((one) => one.dataset.key === "host/cpu|cpu|busy").cells[5].textContent));
    await until(page, () => [...document.querySelectorAll("#values canvas")].some((one) => one.getContext("2d").getImageData(0, 0, one.width, one.height).data.some((byte) => byte)));
    await page.type("#filter", "memory");
    await until(page, () => [...document.querySelectorAll("#values tbody tr")].every((one) => /memory/.test(one.textContent)));
    await page.click("#values tbody tr:first-child button");
    await page.$eval("#filter", (one) => { one.value = "busy"; one.dispatchEvent(new Event("input")); });
    await until(page, () => [...document.querySelectorAll("#values tbody tr")].some((one) => /memory/.test(one.textContent)));
    assert.match(page.url(), /pin=/);
    await page.$eval("#filter", (one) => { one.value = ""; one.dispatchEvent(new Event("input")); });
  });

  await test("BY-1 charts: several fields, windows, zoom, pause, shared cursor, marks, limits, gaps with reasons", async () => {
    await until(page, () => Charts.charts.length === 1 && Charts.charts[0].drawn.length > 3);
    for (const wanted of ["host/cpu.user", "host/cpu.busy", "host/load.running"])
      if (!await page.evaluate((name) => Charts.charts.some((one) => one.fields.some((field) => field.topic + "." + field.path === name)), wanted))
        await page.$$eval("#values button.field", (all, name) => all.find((one) => one.textContent === name).click(), wanted);
    await until(page, () => Charts.charts[0].fields.length >= 3);  // of two units, on two axes
    await until(page, () => new Set(Charts.charts[0].fields.map((one) => Charts.charts[0].axisOf(one))).size === 2);
    await page.select("#range", "10 s");
    await until(page, () => { const shown = Charts.shown(); return Math.abs(shown.until - shown.from - 10e3) < 1; });
    // The run is stopped for two seconds: that is a gap, with a reason and a count.
    run.child.kill("SIGSTOP");
    await until(page, () => document.getElementById("top").classList.contains("silent"));
    run.child.kill("SIGCONT");
    await until(page, () => document.getElementById("connection").textContent === "live");
    await until(page, () => Charts.gapsOf("host/cpu", "cpu").some((gap) => gap.kind === "missed" && gap.count >= 10 && gap.reason));
    await until(page, () => /missed/.test(document.querySelector(".reasons").textContent));
    await until(page, () => Charts.charts.some((one) => one.drawn.some((row) => row.slice(1).some((value) => value && Number.isNaN(value[1])))));
    const plot = await page.$(".plot");
    const box = await plot.boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await until(page, () => Charts.charts[0].pointed === true);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width * 0.8, box.y + box.height / 2, {steps: 5});
    await page.mouse.up();
    await until(page, () => Charts.isPaused() && Charts.shown().until - Charts.shown().from < 8e3);
    const paused = await page.evaluate(() => Charts.shown().until);
    await new Promise((done) => setTimeout(done, 700));
    assert.equal(await page.evaluate(() => Charts.shown().until), paused);
    await page.click("#pause");
    await until(page, () => !Charts.isPaused());
    assert.match(page.url(), /chart=.*busy/);
    const csv = await page.evaluate(() => Charts.charts[0].csv());
    assert.match(csv, /^time,.*host\/cpu\.busy mean.*\n20\d\d-\d\d-\d\dT[\d:.]+Z,/);
    const picture = await page.evaluate(() => Charts.charts[0].picture().toDataURL().length);
    assert.ok(picture > 5000);
  });

  await test("BY-1 commands: note, event, arm held, set, stop and start; each is answered and recorded with who", async () => {
    await page.type("#who", "Ada");
    await page.type("#commands form[aria-label=Note] input", "valve " + evil);
    await page.click("#commands form[aria-label=Note] button");
    await until(page, () => /: noted$/.test(document.getElementById("answer").textContent));
    await until(page, () => Charts.marks.some((mark) => /valve .* by Ada \(page, 127\.0\.0\.1\)/.test(mark.text)));
    await page.click("#commands form[aria-label=Give] button");
    await until(page, () => /^flightup/.test(document.querySelector("#machines tbody tr").textContent));
    await page.click("#commands button.hold");  // a click alone is not enough
    await new Promise((done) => setTimeout(done, 300));
    assert.doesNotMatch(await text(page, "#answer"), /armed/);
    const hold = await (await page.$("#commands button.hold")).boundingBox();
    await page.mouse.move(hold.x + 5, hold.y + 5);
    await page.mouse.down();
    await until(page, () => /is armed$/.test(document.getElementById("answer").textContent));
    await page.mouse.up();
    await page.type("#commands form[aria-label=Set] input", "1");
    await page.click("#commands form[aria-label=Set] button");
    await until(page, () => { const cells = [...document.querySelectorAll("#outputs tbody tr td")].map((one) => one.textContent); return cells[1] === "1" && cells[2] === "1" && cells[4] === "armed" && /Ada/.test(cells[5]); });
    await page.select("#commands form[aria-label=Stop] select", "mem");
    await page.click("#commands form[aria-label=Stop] button");
    await until(page, () => /sensor mem is stopped/.test(document.getElementById("answer").textContent));
    await until(page, () => [...document.querySelectorAll("#values tbody tr.stale")].some((one) => /host\/memory/.test(one.textContent)));
    await page.select("#commands form[aria-label=Start] select", "mem");
    await page.click("#commands form[aria-label=Start] button");
    await until(page, () => /sensor mem is started/.test(document.getElementById("answer").textContent));
    await page.click("#commands form[aria-label='Disarm lamp'] button");
    await until(page, () => /is disarmed/.test(document.getElementById("answer").textContent));
  });

  await test("BY-1 health of sensors, sinks and loops is there", async () => {
    await until(page, () => /neverfaulted/.test(document.getElementById("sensors").textContent));
    assert.match(await text(page, "#sinks tbody"), /^recok\d+/);
    assert.match(await text(page, "#loops tbody"), /%/);
    await shot(page, "page.png");
  });

  await test("BY-1 a link shows the same layout, with history from before it was opened", async () => {
    const token = address.match(/token=(.*)/)[1];
    const link = page.url();
    const other = await open(link + "&token=" + token);
    await until(other, () => document.getElementById("connection").textContent === "live");
    const layout = (one) => one.evaluate(() => [document.getElementById("range").value, ...Charts.charts.map((chart) => chart.fields.map((field) => field.topic + "." + field.path).join())]);
    await until(other, (wanted) => JSON.stringify([document.getElementById("range").value, ...Charts.charts.map((chart) => chart.fields.map((field) => field.topic + "." + field.path).join())]) === wanted, JSON.stringify(await layout(page)));
    // Points of before it was opened, of the recording.
    await until(other, () => { const chart = Charts.charts[0]; return chart.fields[0].past.length > 3 && chart.fields[0].past[0].time < chart.fineFrom - 1000; });
    await other.close();
  });

  await test("BY-1 on a phone of 360 px nothing is wider than the screen; dark has another ground; keys work", async () => {
    const phone = await open(address.replace("#", "#theme=dark&"), 360, 700);
    await until(phone, () => Charts.charts.length > 0 && document.querySelectorAll("#values tbody tr").length > 3);
    assert.ok(await phone.evaluate(() => document.documentElement.scrollWidth <= 360), "it is wider: " + await phone.evaluate(() => document.documentElement.scrollWidth));
    assert.equal(await phone.evaluate(() => getComputedStyle(document.body).backgroundColor), "rgb(20, 23, 26)");
    await phone.keyboard.press("Space");
    await until(phone, () => Charts.isPaused());
    await phone.keyboard.press("Escape");
    await until(phone, () => !Charts.isPaused());
    const nameless = await phone.$$eval("button, input, select", (all) => all.filter((one) => one.checkVisibility() && !(one.textContent.trim() || one.getAttribute("aria-label") || (one.labels && one.labels.length))).map((one) => one.outerHTML));
    assert.deepEqual(nameless, []);
    await shot(phone, "page-phone.png");
    await phone.close();
  });

  await test("BY-1 texts of devices, people and files are text, never markup", async () => {
    assert.equal(await page.evaluate(() => window.evil), undefined);
    assert.equal(await page.$$eval("img", (all) => all.length), 0);
    assert.match(await text(page, "#name"), /<img src=x/);
    assert.match(await text(page, "#sensors tbody"), /<img src=x/);
  });

  await test("BY-1 the page of a recording, while it is recorded and at rest, is the same page", async () => {
    const viewing = start("view", "bench.db", "--listen", "127.0.0.1:0");
    const live = await open(await viewing.address);
    await until(live, () => document.getElementById("connection").textContent === "live" && document.querySelectorAll("#values tbody tr").length >= 5);
    await until(live, () => Charts.charts.length > 0 && Charts.charts[0].drawn.length > 3);
    await until(live, () => { const row = [...document.querySelectorAll("#values tbody tr")].find((one) => one.dataset.key === "host/cpu|cpu|busy"); return row && row.cells[2].textContent !== "" && /^[0-5](\.\d)? s$/.test(row.cells[4].textContent); });
    await until(live, () => Charts.marks.some((mark) => /valve/.test(mark.text)));
    viewing.child.kill("SIGTERM");
    assert.equal(await viewing.child.ended, 0);

    run.child.kill("SIGTERM");
    assert.equal(await run.child.ended, 0, run.child.said);
    await until(page, () => document.getElementById("top").classList.contains("silent"));
    const rest = start("view", "bench.db", "--listen", "127.0.0.1:0");
    const still = await open((await rest.address).replace("#", "#range=all&"));
    await until(still, () => document.getElementById("connection").textContent === "recording (not running)");
    await until(still, () => Charts.charts.length > 0 && Charts.charts[0].drawn.length > 10);
    await until(still, () => /lost since the start: [1-9]/.test(document.getElementById("lost").textContent));
    await until(still, () => /^run 1/.test(document.getElementById("run").textContent));
    await shot(still, "page-view.png");
    rest.child.kill("SIGTERM");
    assert.equal(await rest.child.ended, 0);
  });

  await test("BY-1 no page made an error, broke its own policy, or asked another host", () => {
    // What was asked while the run ended is answered so.
    assert.deepEqual(problems.filter((one) => !/ERR_(CONNECTION|INCOMPLETE|EMPTY)|status of 503/.test(one)), []);
  });
} finally {
  await end();
  device.close();
}
process.exit(failed() ? 1 : 0);
