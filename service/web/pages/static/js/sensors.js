// Which temperatures of an asset the charts show: its rings, or those of its own network.
import { RINGS } from './channels.js';

const MOST_LINES = 3;
const NOT_SHOWN = 'ambient_c';

/** Names of the channels that an asset measures. */
export const channelNames = (asset) => (asset?.channels ?? []).map((channel) => channel.name)
  .filter((name) => !name.endsWith('.twin'));

/**
 * The measured temperatures of the charts, at most three: the rings of a bearing, else those
 * with limits first.
 */
export function chartSensors(asset) {
  const measured = channelNames(asset);
  const rings = RINGS.filter((name) => measured.includes(name));
  if (rings.length) return rings;
  const limited = Object.keys(asset?.limits ?? {}).filter((name) => measured.includes(name));
  const others = measured.filter((name) =>
    /^t_.*_c$/.test(name) && name !== NOT_SHOWN && !limited.includes(name));
  return [...limited, ...others].slice(0, MOST_LINES);
}
