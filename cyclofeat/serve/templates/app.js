"use strict";
// The server renders all parts; this script sends what is chosen and shows the parts that have changed.

const at = (id) => document.getElementById(id);
const shown = {}; // HTML of each part, by its id
const inspected = new Set(); // recordings for which an inspection was asked
let uploading = false;
let timer;
let repeated; // newest job whose error was shown at its button

function show(id, html) {
  if (shown[id] === html) return;
  shown[id] = html;
  const place = at(id);
  const value = place.value;
  const before = [...place.querySelectorAll("[id]")].map((one) => [one.id, one.checked, one.open]);
  const focused = place.contains(document.activeElement) ? document.activeElement.id : "";
  place.innerHTML = html; // escaped by the server's templates
  nameFields(place);
  if (value) place.value = value;
  if (place.tagName === "SELECT" && place.selectedIndex < 0) place.selectedIndex = 0;
  for (const [name, checked, open] of before) {
    const one = at(name);
    if (!one) continue;
    if (one.type === "checkbox") one.checked = checked;
    if (open) one.open = true;
  }
  if (focused && at(focused)) at(focused).focus();
}

/** Text with the label of a field in place of its option, as "--speed". */
function labelled(text) {
  const message = text.replace(/argument (?=--)/g, "").replace(/; see cyclofeat \w+ --help/g, "");
  return message.replace(/--[a-z][a-z-]*[a-z]/g, (option) => {
    const small = [...document.querySelectorAll("#options small")]
      .find((one) => one.textContent.split(/[,;]/)[0] === option);
    if (!small) return option;
    const field = small.closest("label");
    const label = field ? field.firstChild.data : small.parentElement.querySelector("label").textContent;
    return `“${label.replace(/\s+/g, " ").trim()}”`;
  });
}

/** Name fields in the messages of a part, but not in its command lines. */
function nameFields(part) {
  const texts = document.createTreeWalker(part, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const { data, parentElement } = texts.currentNode;
    if (data.includes("--") && !parentElement.closest("pre")) texts.currentNode.data = labelled(data);
  }
}

/** Show the error of the newest job at its button too, until the next request. */
function repeatError() {
  const newest = document.querySelector("#jobs .job");
  const error = newest && newest.querySelector(":scope > p.wrong");
  const place = error && at(`problem-${newest.dataset.job}`);
  if (!place || repeated === newest.getAttribute("aria-labelledby")) return;
  repeated = newest.getAttribute("aria-labelledby");
  place.textContent = error.textContent;
}

function say(text) {
  if (at("status").textContent !== text) at("status").textContent = text;
}

async function ask(method, path, body) {
  const answer = await fetch(path, { method, body });
  const said = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new Error(said.error || `the server answered ${answer.status}`);
  return said;
}

/** Do something that the server may refuse, and show why: at the button of a command, if it has a place there. */
async function attempt(work, command) {
  document.querySelectorAll(".problem").forEach((one) => (one.textContent = ""));
  try {
    await work();
  } catch (error) {
    (at(`problem-${command}`) || at("problem")).textContent = labelled(error.message);
  }
  await refresh();
}

async function refresh() {
  clearTimeout(timer);
  let wait = 2000;
  try {
    const state = await ask("GET", "state");
    for (const [id, html] of Object.entries(state.html)) show(id, html);
    repeatError();
    if (!uploading) {
      say(labelled(state.status));
      inspect(state.uninspected);
    }
    if (state.busy) wait = 500;
  } catch (error) {
    say(`The page has lost its connection to the server (${error.message}). Start cyclofeat serve again, and open its address.`);
  }
  clearTimeout(timer);
  timer = setTimeout(refresh, wait);
}

function inspect(names) {
  const fresh = names.filter((name) => !inspected.has(name));
  if (!fresh.length) return;
  fresh.forEach((name) => inspected.add(name));
  start("inspect", fresh);
}

const chosen = () => [...document.querySelectorAll(".chosen:checked")].map((box) => box.value);

function start(command, recordings) {
  const options = {};
  for (const field of at("options").elements) {
    const only = field.dataset.only;
    const counts = field.name && (!only || only === command) && (field.type !== "checkbox" || field.checked);
    if (counts && field.value) options[field.name] = field.value;
  }
  return attempt(() => ask("POST", "jobs", JSON.stringify({ command, recordings, options })), command);
}

// -- uploads

async function upload(groups) {
  const total = groups.reduce((sum, group) => sum + group.files.length, 0);
  let done = 0;
  const problems = [];
  uploading = true;
  for (const group of groups) {
    let folder = "";
    for (const file of group.files) {
      done += 1;
      say(`Reading ${file.name}, ${done} of ${total}.`);
      try {
        if (group.folder && !folder) {
          folder = (await ask("POST", `folders?name=${encodeURIComponent(group.folder)}`)).name;
        }
        const inside = folder ? `&folder=${encodeURIComponent(folder)}` : "";
        await ask("POST", `files?name=${encodeURIComponent(file.name)}${inside}`, file);
      } catch (error) {
        problems.push(`${file.name}: ${error.message}`);
      }
    }
  }
  uploading = false;
  await attempt(() => {
    if (problems.length) throw new Error(problems.slice(0, 5).join("; "));
  }, "simulate");
}

/** Files of one folder and of the folders in it, each folder a group of its own. */
function grouped(files) {
  const groups = new Map();
  for (const file of files) {
    if (file.name.startsWith(".")) continue;
    const path = (file.place || file.webkitRelativePath || file.name).split("/");
    const folder = path.slice(0, -1).join("/");
    const key = folder || Symbol("by itself");
    if (!groups.has(key)) groups.set(key, { folder: path.at(-2) || "", files: [] });
    groups.get(key).files.push(file);
  }
  return [...groups.values()];
}

async function entered(entry, files) {
  if (entry instanceof File) {
    files.push(entry);
    return;
  }
  if (entry.isFile) {
    const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
    file.place = entry.fullPath.slice(1);
    files.push(file);
    return;
  }
  const reader = entry.createReader();
  for (;;) { // a reader gives some hundred entries at a time
    const entries = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (!entries.length) return;
    for (const one of entries) await entered(one, files);
  }
}

for (const name of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault(); // a file dropped beside the frame must not replace the page
    at("drop").classList.toggle("over", name === "dragover");
  });
}

document.addEventListener("drop", (event) => {
  // A file that another program holds in memory has no entry.
  const dropped = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry() || item.getAsFile());
  attempt(async () => {
    const files = [];
    for (const entry of dropped.filter(Boolean)) await entered(entry, files);
    if (!files.length) throw new Error("The dropped items contain no files.");
    await upload(grouped(files));
  }, "simulate");
});

/** Send models, before their cards, rigs and posteriors. */
async function uploadOthers(files) {
  const sorted = [...files].sort((a, b) => b.name.endsWith(".skops") - a.name.endsWith(".skops"));
  for (const file of sorted) await ask("POST", `others?name=${encodeURIComponent(file.name)}`, file);
}

/** State channel, quantity and speed of one file, and look at it again. */
async function stateFacts(fields) {
  const name = fields.dataset.stated, facts = {};
  for (const field of fields.querySelectorAll("[name]")) facts[field.name] = field.value;
  await attempt(() => ask("POST", `stated?name=${encodeURIComponent(name)}`, JSON.stringify(facts)));
  await start("inspect", [name]);
}

async function remove(names) {
  for (const name of names) {
    inspected.delete(name);
    await ask("DELETE", `recordings?name=${encodeURIComponent(name)}`);
  }
}

// -- what the reader does

document.addEventListener("change", (event) => {
  const { id, files, name } = event.target;
  if (id === "files" || id === "folder") upload(grouped([...files]));
  else if (id === "model-files") attempt(() => uploadOthers(files), "model");
  else if (id === "gap-file-chooser") attempt(() => uploadOthers(files), "gap");
  else if (event.target.closest("[data-stated]")) stateFacts(event.target.closest("[data-stated]"));
  else if (name && !event.target.dataset.only && chosen().length) start("inspect", chosen());
  if (files) event.target.value = ""; // the same files can be chosen again
});

document.addEventListener("click", (event) => {
  const { command, cancel, remove: name, removeAll, clear } = event.target.dataset;
  if (command) start(command, chosen());
  else if (cancel) attempt(() => ask("POST", `jobs/${cancel}/cancel`));
  else if (clear) attempt(() => ask("DELETE", "jobs"));
  else if (name) attempt(() => remove([name]));
  else if (removeAll) attempt(() => remove([...document.querySelectorAll(".chosen")].map((box) => box.value)));
});

at("options").addEventListener("submit", (event) => event.preventDefault());
refresh();
