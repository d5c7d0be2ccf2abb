// Pages opened as files start no workers: the script of the search runs in a hidden frame instead.
if (location.protocol === "file:") {
  window.Worker = class {
    constructor(script) {
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      // a document with a source is loaded once in every browser, an empty frame is not
      this.frame.srcdoc = "<!doctype html>";
      this.scope = new Promise((resolve, reject) => {
        this.frame.addEventListener("load", () => {
          const scope = this.frame.contentWindow;
          scope.postMessage = (data) => this.send(this, data);
          const element = scope.document.createElement("script");
          element.src = new URL(script, location.href);
          element.onload = () => resolve(scope);
          element.onerror = reject;
          scope.document.head.append(element);
        });
      });
      this.scope.catch((error) => this.onerror?.(error));
      document.body.append(this.frame);
    }

    postMessage(data) {
      this.scope.then((scope) => this.send(scope, data), () => {});
    }

    // a copy, as of a worker's messages
    send(receiver, data) {
      const copy = structuredClone(data);
      setTimeout(() => receiver.onmessage?.({ data: copy }));
    }

    terminate() {
      this.frame.remove();
    }
  };
}

// Blocks with comments wrap instead of hiding them beyond the edge; tables of output keep their lines.
addEventListener("DOMContentLoaded", () => {
  for (const code of document.querySelectorAll("pre > code")) {
    if (!/(^|\s)(#|\/\/) /m.test(code.textContent)) continue;
    code.classList.add("wraps");
    // highlighted code has elements for its comments
    if (code.childElementCount) continue;
    const lines = code.textContent.match(/.*\n|.+$/g);
    code.textContent = "";
    for (const text of lines) {
      const [, command, gap, comment] = text.match(/^(.*?)(\s+)((?:#|\/\/) [^]*)$/) ?? ["", text, "", ""];
      code.append(command);
      for (const [name, part] of [["gap", gap], ["comment", comment]]) {
        if (!part) continue;
        const element = document.createElement("span");
        element.className = name;
        element.textContent = part;
        code.append(element);
      }
    }
  }
});
