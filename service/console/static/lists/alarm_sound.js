/** @file A sound for new alarms: off until somebody switches it on, and off again with the page. */

import { element } from "../element.js";
import { words } from "../words.js";

/** Changes that make a sound; a shelved or suppressed alarm makes none. */
const CHANGES = ["raised", "escalated", "repeated"];
const HIGH_HZ = 880;
const LOW_HZ = 440;
const LOUD = ["severe", "critical", "distress"];

/** Of the page; a browser lets one sound only after somebody has pressed something. */
let sound = null;
let isOn = false;
let end = () => {};

/** @param {any} store */
export function soundSwitch(store) {
  const box = element("input", { type: "checkbox", checked: isOn });
  box.addEventListener("change", () => {
    isOn = box.checked;
    end();
    end = isOn ? store.on("alarm", (change) => change.is_told && CHANGES.includes(change.change) && play(change.alarm.severity)) : () => {};
    if (isOn) play("watch");
  });
  return element("label", { class: "labelled inline" }, box, words("views.alarms.sound"));
}

/** Sound once, high for what is distress or worse. */
function play(severity) {
  sound ??= new AudioContext();
  const source = sound.createOscillator();
  const volume = sound.createGain();
  source.frequency.value = LOUD.includes(severity) ? HIGH_HZ : LOW_HZ;
  volume.gain.setValueAtTime(0.2, sound.currentTime);
  volume.gain.exponentialRampToValueAtTime(0.001, sound.currentTime + 0.4);
  source.connect(volume).connect(sound.destination);
  source.start();
  source.stop(sound.currentTime + 0.4);
}
