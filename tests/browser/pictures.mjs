// Makes the pictures of docs/page.md from a real run: pictures.mjs PROGRAM FOLDER.
import {spawn} from "node:child_process";
import {mkdirSync, mkdtempSync, rmSync, writeFileSync} from "node:fs";
import {tmpdir} from "node:os";
import {join} from "node:path";
import puppeteer from "puppeteer-core";

const [program, pictures] = process.argv.slice(2);
const folder = mkdtempSync(join(tmpdir(), "rtdata-pictures-"));
mkdirSync(join(folder, "run"), {mode: 0o700});
writeFileSync(join(folder, "bench.json"), JSON.stringify({
  name: "bench", notes: "first run with the new board", page: {listen: "127.0.0.1:0", commands: ["note", "ack"]},
  sensors: [
    {name: "cpu", type: "host", quantity: "cpu", rate: "50 Hz", topic: "host/cpu"},
    {name: "load", type: "host", quantity: "load", rate: "5 Hz", topic: "host/load"},
    {name: "busy", type: "limit", on: "host/load", field: "running", high: 8, high_high: 20, hysteresis: 2},
  ],
  sinks: [{type: "sqlite", path: "bench.db"}],
}));
const run = spawn(program, ["run", "bench.json"], {cwd: folder, env: {...process.env, RTDATA_RUNTIME_DIR: join(folder, "run")}});
const address = await new Promise((done) => {
  let said = "";
  run.stderr.on("data", (text) => { said += text; const found = said.match(/http:\S+#token=\S+/); if (found) done(found[0]); });
});
const wait = (seconds) => new Promise((done) => setTimeout(done, seconds * 1000));
const browser = await puppeteer.launch({executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu"]});
try {
  await wait(40);  // the charts show a minute
  run.kill("SIGSTOP");  // a gap
  await wait(2);
  run.kill("SIGCONT");
  await wait(8);
  for (const [name, width, height, theme] of [["page.png", 1100, 900, "light"], ["page-phone.png", 360, 720, "dark"]]) {
    const page = await (await browser.createBrowserContext()).newPage();
    await page.setViewport({width, height});
    await page.goto(address.replace("#", `#theme=${theme}&range=1+min&chart=host%2Fcpu.busy%2Chost%2Fcpu.user&chart=host%2Fload.running&`));
    await page.waitForFunction(() => Charts.charts.length === 2 && Charts.charts.every((one) => one.fields[0].past.length > 5));
    await wait(4);
    await page.screenshot({path: join(pictures, name)});
  }
} finally {
  await browser.close();
  run.kill("SIGTERM");
  await new Promise((done) => run.on("exit", done));
  rmSync(folder, {recursive: true, force: true});
}
