// What the tests of the live page share: the program, Chromium, and what is asked of a page.
// Ends with 77, and says why, where there is no Chromium, or no puppeteer-core (script/bootstrap --all installs it).
import {spawn} from "node:child_process";
import {existsSync, mkdirSync, mkdtempSync, rmSync} from "node:fs";
import {tmpdir} from "node:os";
import {join} from "node:path";

function skip(why) {
  console.log("skipped: " + why);
  process.exit(77);
}
/// `titles`: of the tests that are wanted, a part of their title.
export const [program, pictures, titles = ""] = process.argv.slice(2);
const chromium = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find(existsSync);
if (!chromium) skip("there is no Chromium: the page is not tried in a browser");
const puppeteer = (await import("puppeteer-core").catch(() => skip("there is no puppeteer-core: script/bootstrap --all"))).default;

export const folder = mkdtempSync(join(tmpdir(), "rtdata-page-"));
mkdirSync(join(folder, "run"), {mode: 0o700});
export const environment = {...process.env, RTDATA_RUNTIME_DIR: join(folder, "run")};
const started = [];
/// Starts the program, and waits for the address of its page.
export function start(...words) {
  const child = spawn(program, words, {cwd: folder, env: environment});
  started.push(child);
  child.said = "";
  child.ended = new Promise((done) => child.on("exit", done));
  const address = new Promise((done, failed) => {
    for (const stream of [child.stdout, child.stderr])
      stream.on("data", (text) => {
        child.said += text;
        const found = child.said.match(/https?:\/\/\S+#token=\S+/);
        if (found) done(found[0]);
      });
    child.on("exit", () => failed(new Error("it ended: " + child.said)));
  });
  return {child, address};
}

export const browser = await puppeteer.launch({executablePath: chromium, args: ["--no-sandbox", "--disable-gpu"], acceptInsecureCerts: true});
let failures = 0;
export async function test(title, body) {
  if (!title.includes(titles)) return;
  try {
    await body();
    console.log("ok: " + title);
  } catch (error) {
    ++failures;
    if (pictures) for (const [i, one] of (await browser.pages()).entries()) await one.screenshot({path: join(pictures, `failed-${failures}-${i}.png`)}).catch(() => {});
    console.log("FAILED: " + title + "\n" + error.stack);
    for (const one of started)
      if ((one.exitCode !== null || one.signalCode !== null) && !one.isTold) {
        console.log(`${one.spawnargs.join(" ")} has ended with ${one.exitCode} ${one.signalCode}: ${one.said.slice(-1000)}`);
        one.isTold = true;
      }
  }
}
export const problems = [];
export async function open(address, width = 1100, height = 800, prepare = async () => {}) {
  const page = await (await browser.createBrowserContext()).newPage();
  await page.setViewport({width, height});
  page.on("pageerror", (error) => problems.push("error: " + error.message));
  page.on("console", (message) => { if (message.type() === "error") problems.push("console: " + message.text()); });
  page.on("request", (request) => { if (!/^(blob:)?https?:\/\/127\.0\.0\.1/.test(request.url())) problems.push("another host: " + request.url()); });
  await page.evaluateOnNewDocument(() => addEventListener("securitypolicyviolation", (event) => console.error("policy: " + event.violatedDirective + " " + event.blockedURI)));
  await prepare(page);
  await page.goto(address, {waitUntil: "domcontentloaded"});
  return page;
}
export const patience = 60e3;
/// Waits until it is so in the page, a minute at most.
export const until = (page, what, ...words) => page.waitForFunction(what, {timeout: patience, polling: 200}, ...words);
export const text = (page, selector) => page.$eval(selector, (one) => one.textContent);
export const shot = async (page, name) => { if (pictures) await page.screenshot({path: join(pictures, name)}); };
export async function end() {
  await browser.close();
  for (const child of started) if (child.exitCode === null) child.kill("SIGKILL");
  rmSync(folder, {recursive: true, force: true});
}
export const failed = () => failures > 0;
