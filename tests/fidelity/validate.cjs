// What Khronos' glTF validator says of the files named: one JSON document, a report a file.
const { readFileSync } = require('node:fs');
const validator = require(`${process.cwd()}/node_modules/gltf-validator`);

Promise.all(process.argv.slice(2).map((file) => validator.validateBytes(new Uint8Array(readFileSync(file)))))
  .then((reports) => console.log(JSON.stringify(reports)));
