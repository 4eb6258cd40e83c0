// The frame of the playground is as high as its content, and light or dark as the page around it.
document.addEventListener("DOMContentLoaded", () => {
  const frame = document.querySelector("iframe.playground");
  if (!frame) return;
  const tellTheme = () => frame.contentWindow.postMessage({ theme: document.documentElement.dataset.theme }, "*");
  window.addEventListener("message", ({ source, data }) => {
    if (source !== frame.contentWindow || !(data?.playground > 0)) return;
    frame.style.height = `${Math.ceil(data.playground) + 4}px`;
    tellTheme();
  });
  frame.addEventListener("load", tellTheme);
  new MutationObserver(tellTheme).observe(document.documentElement, { attributeFilter: ["data-theme"] });
});
