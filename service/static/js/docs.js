// The HTTP interface, to read and to try: Swagger UI, with the API key that this tab has been given on the page.

import { askJson, keyed } from "./api.js";
import { make } from "./dom.js";

/**
 * A description without HEAD, which is wherever GET is, with forms that start with defaults, not with examples, and beside
 * them empty queries: the service takes one or the other, and has the same defaults.
 */
function adapted(spec) {
  for (const methods of Object.values(spec.paths)) {
    delete methods.head;
    for (const { requestBody, parameters = [] } of Object.values(methods)) {
      const fields = requestBody?.content["multipart/form-data"]?.schema.properties;
      if (fields) for (const { in: part, schema } of parameters) if (part === "query") delete schema.default;
      for (const field of Object.values(fields ?? {})) {
        if (field.type === "array") field.example = [];
        else if (field.default === undefined && field.format !== "binary") Object.assign(field, { example: "", examples: undefined });
      }
    }
  }
  return spec;
}

const place = document.querySelector("#api");

try {
  globalThis.SwaggerUIBundle({
    spec: adapted(await askJson("/openapi.json")),
    domNode: place,
    deepLinking: true,
    validatorUrl: null, // on another host
    requestInterceptor: (request) => ({ ...request, headers: keyed(request.headers) }),
  });
} catch (error) {
  const problem = error.problem ?? { title: "Error", detail: String(error) };
  place.append(make("p", { role: "alert" }, make("strong", {}, problem.title), `: ${problem.detail}`));
  if (error.status === 401) place.append(make("p", {}, "Give it on ", make("a", { href: "/" }, "the page"), ", then come back in the same tab."));
}
