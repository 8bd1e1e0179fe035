// What is scrolled out of the window, or in a tab behind, is not drawn: on a small window most cameras are.

export class Seen {
  // `draw` is called whenever the element comes into view
  constructor(element, draw) {
    this.near = false;
    this.redraw = () => { if (this.now) draw(); };
    this.observer = new IntersectionObserver((entries) => {
      this.near = entries[entries.length - 1].isIntersecting;
      this.redraw();
    });
    this.observer.observe(element);
    document.addEventListener("visibilitychange", this.redraw);
  }

  get now() { return this.near && !document.hidden; }

  close() {
    this.observer.disconnect();
    document.removeEventListener("visibilitychange", this.redraw);
  }
}
