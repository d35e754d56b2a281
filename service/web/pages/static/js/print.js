// Paper is light, whatever the theme of the screen is.
const { dataset } = document.documentElement;

window.addEventListener('beforeprint', () => {
  dataset.drawn = dataset.theme; // what the canvases keep their colours of
  dataset.theme = 'light';
});
window.addEventListener('afterprint', () => {
  dataset.theme = dataset.drawn;
  delete dataset.drawn;
});
