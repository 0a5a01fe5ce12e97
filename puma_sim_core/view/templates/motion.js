/* SPDX-License-Identifier: Apache-2.0 */
/* Copyright the puma-sim contributors */
// A line in each plot at the time of the player's slider; a click on a plot moves the slider.
(() => {
  const panel = document.getElementById("plots");
  const first = Number(panel.dataset.first);
  const plots = [...panel.querySelectorAll(".drawn")].map((plot) => {
    const [left, top, right, bottom, low, high] = plot.querySelector("svg").dataset.axes.split(" ").map(Number);
    const line = plot.querySelector(".now");
    line.style.top = 100 * top + "%";
    line.style.height = 100 * (bottom - top) + "%";
    plot.addEventListener("click", (event) => {
      const box = plot.getBoundingClientRect();
      const share = ((event.clientX - box.left) / box.width - left) / (right - left);
      seek(low + share * (high - low) - first);
    });
    return (time) => { line.style.left = 100 * (left + ((time - low) / (high - low)) * (right - left)) + "%"; };
  });

  // the field of the time stops the player at once, but rounds to 0.1 s; the slider then moves it to the place itself
  function seek(time) {
    const input = document.querySelector("#root input");
    // what React put over the property of this element would hide the change from it
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(input, String(Math.max(0, time)));
    input.dispatchEvent(new Event("input", { bubbles: true }));
    const slider = document.querySelector('#root [role="slider"]');
    const track = slider.closest(".mantine-Slider-root").querySelector(".mantine-Slider-track");
    const box = track.getBoundingClientRect();
    const share = time / Number(slider.getAttribute("aria-valuemax"));
    const there = { bubbles: true, clientX: box.left + share * box.width, clientY: box.top + box.height / 2 };
    for (const type of ["mousedown", "mouseup"]) track.dispatchEvent(new MouseEvent(type, there));
  }

  let shown = null;
  (function follow() {
    const slider = document.querySelector('#root [role="slider"]');
    const time = slider && first + Number(slider.getAttribute("aria-valuenow"));
    if (slider && time !== shown) { plots.forEach((place) => place(time)); shown = time; }
    requestAnimationFrame(follow);
  })();
})();
