// How far a forecast is from a thermal runaway, in words.
import { fixed, isNumber, percent } from './format.js';

const ROUND_N = 50; // newtons are not known better

/** The margin of a forecast's heaviest point; empty while no identified model tells one. */
export function marginText(margin) {
  if (!margin) return '';
  const { margin_n: newtons, margin_k: kelvins, load_n: load, probability } = margin;
  // Loads up to twice that of the point are looked at.
  const parts = [isNumber(newtons) ? `${fixed(ROUND_N * Math.round(newtons / ROUND_N), 0)} N`
    : `more than ${fixed(load, 0)} N`];
  if (isNumber(kelvins)) parts.push(`${fixed(kelvins, 0)} K`);
  return `Margin to thermal runaway: ${parts.join(' / ')}, probability ${percent(probability)}`;
}

/** What the figures mean, for who points at them. */
export function marginTitle(margin) {
  if (!margin) return '';
  const at = `${fixed(margin.speed_rpm, 0)} rpm, ${fixed(margin.load_n, 0)} N`;
  return `The heaviest point of this forecast, held for 8 h: ${at}. N: more load until the `
    + 'probability is 5 %. K: how much hotter until the bearing heats itself.';
}
